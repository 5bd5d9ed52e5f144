"""Stand in for the microcontroller of a rig: the reference firmware on a pseudo-terminal, with the physics behind it.

It prints the path of its port, then speaks the protocol of docs/reference/protocol.md at the rig's sample rate, until
Ctrl-C or SIGTERM stops it. The bridge node, or your own host program, opens that path as any serial port.

examples:
  {run} device_emulator --rig shin2022 --link /tmp/pam_device
  {run} device_emulator --rig shin2022 --link /tmp/pam_device --fault flip=0.01 --fault unplug@5-7 --log voltages.csv
then, in another terminal:
  {run} bridge --ros-args -p port:=/tmp/pam_device

faults, KIND[=VALUE][@BEGIN[-END]] with times in s after the first command:
"""

from __future__ import annotations

import argparse
import gc
import os
import signal
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput


def parser() -> common.Parser:
    """The arguments."""
    from validation.device.line_faults import KINDS

    kinds = "\n".join(f"  {kind.ljust(12)} {meaning}" for kind, meaning in KINDS.items())
    out = common.Parser("device_emulator", __doc__, kinds)
    out.shared("--rig", "--joint", "--lock-angle")
    out.option("--hardware", "calibration of its sensors (default: example)", None, "example", "FILE")
    out.option("--link", "link to the port, so that its name stays the same", Path, metavar="PATH")
    out.shared("--seed")
    mismatch = "relative deviation of the joint's parameters from the rig file (default: 0)"
    out.shared("--mismatch", help=mismatch, default=0.0)
    out.shared("--no-noise")
    out.option("--drift", "error of its clock [ppm] (default: 0)", float, 0.0, "PPM")
    out.option("--first-us", "its 32-bit counter at power-on [us] (default: 0)", int, 0, "US")
    out.option("--log", "CSV file of the voltages on the valves, row by change", Path, metavar="FILE")
    out.repeated("--fault", "a fault to make, see below; may be given several times", "FAULT")
    out.option(
        "--orders", "make this named pipe and read orders from it while running: lines +KIND[=VALUE] (begin a fault) "
        "and -KIND (end it)", Path, metavar="PIPE",
    )  # fmt: skip
    for name, form, metavar, example in (
        ("--flip", "flip=", "SHARE", ""),
        ("--drop", "drop=", "SHARE", ""),
        ("--silent-after", "silent@", "S", ""),
        ("--freeze-sensor", "freeze=", "MUSCLE@S", ", such as 1@2.5"),
    ):
        out.repeated(name, f"the same as --fault {form}{metavar}{example}", metavar, form.__add__, dest="fault")
    return out


def _main(arguments: argparse.Namespace) -> int:
    from pam_antagonist.hardware.calibration import Converter, load_calibration
    from pam_antagonist.hardware.protocol import Feature
    from pam_antagonist.nodes.spin import hurry
    from pam_antagonist.rig import load_rig
    from pam_antagonist.rig.physical import rest_voltage
    from pam_antagonist.simulation.plant import Plant
    from validation.device.emulator import Emulator, Port, VoltageLog
    from validation.device.firmware import DeviceSettings, Firmware
    from validation.device.line_faults import FaultOrders, FaultPlan, parse_fault

    faults = [parse_fault(text) for text in arguments.fault]
    if not abs(arguments.drift) <= 500.0:
        raise BadInput(f"--drift {arguments.drift:g}: expected ppm within ±500; a crystal has 10 to 100")
    if not 0 <= arguments.first_us < 1 << 32:
        raise BadInput(f"--first-us {arguments.first_us}: expected 0 to {(1 << 32) - 1}")
    rig = load_rig(arguments.rig, regulators=True)
    calibration = load_calibration(arguments.hardware)
    converter = Converter(calibration)
    converter.adapt(rig.drive)
    low, high = rig.command_limits
    before = (0.5 * (low + high), 0.5 * (low + high)) if rig.drive == "regulator" else rest_voltage(rig)
    power_on = converter.output(before)
    low, high = min(converter.output((low, low))), max(converter.output((high, high)))
    angle = common.lock_angle(arguments) or 0.0
    plant = Plant(
        rig, arguments.joint, angle, arguments.seed, mismatch=arguments.mismatch, noise=not arguments.no_noise
    )
    # Compiles, or loads, what a step needs, in a plant of its own: the real one starts at rest.
    Plant(rig, arguments.joint, angle).step(before)
    features = Feature(0)
    features |= Feature(0) if calibration.encoder is None else Feature.ENCODER
    features |= Feature(0) if calibration.torque is None else Feature.TORQUE
    features |= Feature.VOLTS if calibration.unit == "V" else Feature(0)
    settings = DeviceSettings(
        name="emulator", features=features, period_us=round(rig.sample_period * 1e6), voltage_min=low, voltage_max=high,
        safe_voltage=power_on,
    )  # fmt: skip
    stopping = _Stopped()
    with ExitStack() as stack:
        log = None if arguments.log is None else stack.enter_context(_log(arguments.log))
        orders = None
        if arguments.orders is not None:
            pipe = FaultOrders(arguments.orders)
            stack.callback(pipe.close)
            orders = pipe.take
        plan = FaultPlan(faults, arguments.seed, orders)
        emulator = Emulator(
            plant, converter, Firmware(settings), plan, VoltageLog(log), lambda: Port(arguments.link),
            arguments.drift * 1e-6, arguments.first_us,
        )  # fmt: skip
        stack.callback(emulator.close)
        print(f"{arguments.link or emulator.path}", flush=True)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, stopping)
        gc.collect()
        gc.freeze()
        gc.disable()
        hurry()
        emulator.run(stopping.asked)
    print(f"{emulator.ticks} samples, {emulator.missed} missed", file=sys.stderr)
    return common.DONE


class _Stopped:
    """Set by a signal, or when the process that this one is to end with is gone."""

    def __init__(self) -> None:
        from pam_antagonist.nodes.processes import PARENT_VARIABLE

        self._parent = int(os.environ.get(PARENT_VARIABLE, "0"))
        self._stopped = False

    def __call__(self, _number: int, _frame: object) -> None:
        self._stopped = True

    def asked(self) -> bool:
        """Whether to stop."""
        return self._stopped or bool(self._parent and os.getppid() != self._parent)


def _log(path: Path) -> TextIO:
    try:
        return path.open("x", encoding="utf-8")
    except OSError as error:
        raise BadInput(f"--log {path}: cannot be made: {error.strerror}; expected the name of a new file") from None


main = common.command(parser, _main)
