"""``./run alarms``: how soon ``monitor`` finds an effect that begins, and how often it alarms where nothing is wrong.

Simulated joints of this project: they say nothing about a real one. The joint moves by the valve voltages of one run
under sensor-less control of its angle, from another place on for each seed, or stands at its rest voltages. Its
parameters differ from the rig file by a percent, its sensors are noisy. Sizes are those of the battery: root mean
square by which the effect moves the channel that it moves most, in noises of a sample, over a minute.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
import time
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np

from pam_antagonist.cli.demo_steps import MODEL
from pam_antagonist.cli.tried_gains import seen
from pam_antagonist.control.command import Mode, VoltageLimits
from pam_antagonist.control.model_law import ModelController, ModelGains
from pam_antagonist.control.laws import Laws, Reachable
from pam_antagonist.control.reference import Wanted
from pam_antagonist.control.stiffness import Box
from pam_antagonist.diagnosis.monitor import THRESHOLD, Monitor
from pam_antagonist.diagnosis.monitor_blocks import alike
from pam_antagonist.diagnosis.monitor_responses import Watched, hypotheses
from pam_antagonist.estimation import Estimator
from pam_antagonist.model import equilibrium, integration, sensor
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Encoder, Rig, load_rig
from pam_antagonist.rig.limits import angle_range, rest_pressure, rest_voltage
from pam_antagonist.simulation.plant import Plant, scattered

Floats = np.ndarray
LEVELS, ONSET, AFTER, LOOP = (4.0, 8.0, 16.0), 180.0, 60.0, 240.0
_ENCODER = Encoder(std=5e-4)


@lru_cache(maxsize=None)
def controlled(name: str) -> Floats:
    """Voltages (N, 2) of a joint whose angle follows a random staircase, without an encoder."""
    rig = load_rig(name, regulators=True)
    p, period, rng = rig.parameters(), rig.sample_period, np.random.default_rng(11)
    box, command = Box.of(p), rest_voltage(rig)
    gains = ModelGains(min(ModelGains().bandwidth, 0.4 / period))
    law = ModelController(p, box, gains, sample_period=period, limits=VoltageLimits(*rig.command_limits), safe_voltage=command)
    laws, estimator, plant = Laws(None, law, Reachable(p, box), MODEL), Estimator(rig), Plant(rig, mismatch=0.005)
    out, every, angle = np.empty((round(LOOP / period), 2)), round(2.5 / period), 0.0
    for k in range(len(out)):
        if k % every == 0:
            angle = float(rng.uniform(-0.7, 0.7)) * angle_range(rig)
        out[k] = command
        sample = plant.step(command)
        row = estimator.step_in_place((k + 1) * round(period * 1e9), *sample.pressure, *sample.voltage)
        command = laws.step(Wanted(Mode.ANGLE, angle), seen(row)).voltage
    return out


class Joint:
    """A simulated joint whose effect may begin at any time."""

    def __init__(self, rig: Rig, name: str, moving: bool, seed: int, mismatch: float = 0.01) -> None:
        self.rig, self.rng = rig, np.random.default_rng(seed)
        self.p = scattered(rig.parameters(), mismatch, self.rng)
        self.voltage = controlled(name) if moving else np.tile(rest_voltage(rig), (1000, 1))
        self.at, self.stamp = int(self.rng.integers(len(self.voltage))), 10**18
        start = rest_pressure(rig)
        self.x = equilibrium.initial_state(equilibrium.rest_angle(start, start, self.p), start, start, self.voltage[0], self.p)

    def change(self, changes: dict[str, float]) -> None:
        """Parameters from now on."""
        known, q = dict(zip(par.added_states(self.p), self.x[4:])), par.changed(self.p, changes)
        state = equilibrium.initial_state(*self.x[[0, 2, 3]], self.voltage[self.at], q)
        state[:4] = self.x[:4]
        for i, name in enumerate(par.added_states(q)):
            state[4 + i] = known.get(name, state[4 + i])
        self.p, self.x = q, state

    def run(self, seconds: float, noise: bool = True) -> tuple[Floats, Floats, Floats, Floats]:
        """Stamps, pressures, voltages and angles of the next seconds."""
        rig, n = self.rig, round(seconds / self.rig.sample_period)
        u = self.voltage[(self.at + np.arange(n + 1)) % len(self.voltage)]
        p, substeps = self.p.copy(), 2 * integration.substeps_of(rig.sample_period)
        p[par.FRICTION_STEP] = rig.sample_period / substeps
        states, _ = integration.course(self.x, u, p, rig.sample_period, substeps)
        self.x, self.at = states[-1].copy(), (self.at + n) % len(self.voltage)
        stamps = self.stamp + np.rint(np.arange(1, n + 1) * rig.sample_period * 1e9).astype(np.int64)
        self.stamp = int(stamps[-1])
        pressure, angle, sensors = sensor.readings(states[1:, 2:4], p), states[1:, 0].copy(), rig.sensors
        if noise:
            pressure = pressure + sensors.pressure_std * self.rng.standard_normal(pressure.shape)
            pressure = np.rint(pressure / sensors.pressure_step) * sensors.pressure_step if sensors.pressure_step else pressure
            angle += _ENCODER.std * self.rng.standard_normal(n)
        return stamps, pressure, u[1:], angle


def amount(rig: Rig, name: str, item: Watched, moving: bool, noises: float) -> float | None:
    """The size that moves a channel by so many noises over a minute; None where no size within bounds does."""
    size, sensors = item.step * 10.0, rig.sensors
    if item.high - item.low <= 0.0:
        return None
    for _ in range(8):
        pair = [Joint(rig, name, moving, 5, 0.0) for _ in range(2)]
        pair[1].change({path: rig.value(path) + size for path in item.paths})
        (_, a, _, one), (_, b, _, two) = (joint.run(60.0, noise=False) for joint in pair)
        moved = max(*np.sqrt(np.mean((a - b) ** 2, axis=0)) / sensors.pressure_std, math.sqrt(np.mean((one - two) ** 2)) / sensors.angle_std)
        if abs(math.log(max(moved, 1e-9) / noises)) < 0.1:
            return size
        size = min(size * float(np.clip(noises / max(moved, 1e-9), 0.2, 5.0)), 0.9 * item.high)
    return size if 0.7 < moved / noises < 1.4 else None


def fed(monitor: Monitor, joint: Joint, seconds: float, encoder: bool) -> Iterator[float]:
    """Runs both; yields the seconds done after each second."""
    done = 0.0
    while done < seconds:
        stamps, pressure, voltage, angle = joint.run(10.0)
        for k in range(10):
            part = slice(k * len(stamps) // 10, (k + 1) * len(stamps) // 10)
            monitor.add(stamps[part], pressure[part], voltage[part], angle[part] if encoder else None)
            done += 1.0
            yield done


def _delay(monitor: Monitor, joint: Joint, item: Watched, size: float, encoder: bool, out: multiprocessing.SimpleQueue) -> None:
    joint.change({path: joint.rig.value(path) + size for path in item.paths})
    for done in fed(monitor, joint, AFTER, encoder):
        found = monitor.findings
        if found and found[0].evidence > THRESHOLD:
            first = found[0]
            named = first.watched.name == item.name, any(name.split()[0] == item.name for name in alike(found))
            out.put((done, named, (first.onset_ns - 10**18) * 1e-9 - ONSET))
            return
    out.put(None)


def main(argv: list[str] | None = None) -> int:
    """Run the measurement; see ``--help``."""
    parser = argparse.ArgumentParser(prog="alarms", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", default="shin2022")
    parser.add_argument("--rest", action="store_true", help="the joint stands")
    parser.add_argument("--encoder", action="store_true", help="the filter has an encoder")
    parser.add_argument("--seeds", type=int, nargs=2, default=(1, 2), help="first and last (1 2)")
    parser.add_argument("--hours", type=float, default=0.0, help="of joints with nothing wrong, in place of effects (0)")
    parser.add_argument("--mismatch", type=float, default=0.01, help="of the joints' parameters (0.01)")
    parser.add_argument("--out", type=Path, help="JSON file")
    chosen = parser.parse_args(argv)
    rig = load_rig(chosen.rig, regulators=True)
    rig = rig.replaced(encoder=_ENCODER) if chosen.encoder else rig
    report: dict[str, object] = {key: str(value) for key, value in vars(chosen).items()}
    rows, hours, began = [], 0.0, time.process_time()
    for seed in range(chosen.seeds[0], chosen.seeds[1] + 1):
        monitor, joint = Monitor(rig, encoder=chosen.encoder), Joint(rig, chosen.rig, not chosen.rest, seed, chosen.mismatch)
        if chosen.hours:
            top, quiet, span = [], 0.0, 3600.0 * chosen.hours
            for done in fed(monitor, joint, span, chosen.encoder):
                if monitor.findings and done > quiet:
                    first = monitor.findings[0]
                    if first.evidence > 10.0:
                        top.append((round(first.evidence, 1), first.watched.name, done))
                        quiet = done + 120.0 if first.evidence > THRESHOLD else quiet
            hours += chosen.hours
            rows.append(sorted(top, reverse=True)[:20])
            print(seed, rows[-1][:6], flush=True)
            continue
        for _ in fed(monitor, joint, ONSET, chosen.encoder):
            pass
        if any(one.evidence > THRESHOLD for one in monitor.findings):
            print(f"seed {seed}: alarm before the onset", flush=True)
        fork, known = multiprocessing.get_context("fork"), set()
        for item in hypotheses(rig, False):
            if (item.name, item.parameter) in known:
                continue
            known.add((item.name, item.parameter))
            for noises in LEVELS:
                size = amount(rig, chosen.rig, item, not chosen.rest, noises)
                if size is None:
                    continue
                out = fork.SimpleQueue()
                child = fork.Process(target=_delay, args=(monitor, joint, item, size, chosen.encoder, out))
                child.start()
                found = out.get()
                child.join()
                rows.append((seed, item.name, item.parameter, noises, size, found))
                print(rows[-1], flush=True)
    report.update(rows=rows, hours=hours, cpu_s=time.process_time() - began)
    if chosen.out:
        chosen.out.write_text(json.dumps(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
