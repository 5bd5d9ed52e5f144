"""Every fault of the matrix, and what is expected of it."""

from __future__ import annotations

from validation.faults.bench import RELAYED
from validation.faults.causes import (
    at_device,
    clock_set_back,
    device_stalled,
    disk_full,
    killed,
    messages,
    neighbour,
    second_commander,
    stalled,
    wrong_rig,
)
from validation.faults.fault import Fault, Recovery, Valves, Wanted

_OK, _WARN, _ERROR = 0, 1, 2
_SAFE, _ON = Valves.SAFE, Valves.CONTROLLED
_RESTART, _CLEAR, _KEPT = Recovery.RESTART, Recovery.CLEAR, Recovery.NOT_LOST
_STALL = 0.05  # [s]
_NO_ESTIMATES = Wanted("controller: commands", _ERROR, "estimates have stopped")
_NO_COMMAND = Wanted("bridge: commands", _WARN, "no command in time")

FAULTS: tuple[Fault, ...] = (
    # ---- processes
    Fault("estimator killed", "SIGKILL", killed("estimator"), _SAFE, (_NO_ESTIMATES,), _RESTART),
    Fault("controller killed", "SIGKILL", killed("controller"), _SAFE, (_NO_COMMAND,), _RESTART),
    Fault("bridge killed", "SIGKILL", killed("bridge"), _SAFE, (_NO_ESTIMATES,), _RESTART),
    Fault("estimator stalls", "SIGSTOP for 50 ms", stalled("estimator", _STALL), _SAFE,
          (Wanted("controller: commands", _WARN, "safe voltages"),), lasts=0.0),
    Fault("controller stalls", "SIGSTOP for 50 ms", stalled("controller", _STALL), _SAFE, (_NO_COMMAND,), lasts=0.0),
    Fault("bridge stalls", "SIGSTOP for 50 ms", stalled("bridge", _STALL), _SAFE,
          (Wanted("bridge: device", _WARN, "watchdog trips"),), lasts=0.0),
    # ---- the device and its line
    Fault("device unplugged", "port closed for 0.6 s", at_device("unplug"), _SAFE,
          (Wanted("bridge: device", _ERROR, "no device"),), lasts=0.6),
    Fault("device silent", "sends nothing for 0.6 s", at_device("silent"), _SAFE,
          (Wanted("bridge: device", _ERROR, "no device: silent"),), lasts=0.6),
    Fault("device deaf", "hears nothing for 0.4 s", at_device("deaf"), _SAFE,
          (Wanted("bridge: device", _WARN, "watchdog trips"),)),
    Fault("device stalls", "stands still for 50 ms", device_stalled(_STALL), _ON,
          (Wanted("estimator: samples", _WARN, "late"),), lasts=0.0),
    Fault("device restarts", "begins anew, clock at 0", at_device("restart"), _SAFE,
          (Wanted("bridge: device", _ERROR, "devices lost", counted=True),), lasts=0.1),
    Fault("damaged frames", "1 % of the bytes, both ways, for 1 s", at_device("flip=0.01"), _ON,
          (Wanted("bridge: device", _WARN, "damaged frames"),), lasts=1.0),
    Fault("emergency stop", "pressed at the device", at_device("stop"), _SAFE,
          (Wanted("bridge: safety", _ERROR, "the emergency stop"),), _CLEAR, clear=("bridge",)),
    # ---- sensors
    Fault("pressure NaN", "sensor 1 for 0.4 s", at_device("nan=1"), _SAFE,
          (Wanted("bridge: safety", _ERROR, "pressure 1 is missing"),), _CLEAR, clear=("controller", "bridge")),
    Fault("pressure wire broken", "sensor 2 shows 0 V", at_device("broken=2"), _SAFE,
          (Wanted("bridge: safety", _ERROR, "pressure 2 is missing"),), _CLEAR, clear=("controller", "bridge")),
    Fault("pressure stuck", "sensor 2 repeats its reading", at_device("freeze=2"), _SAFE,
          (Wanted("bridge: safety", _ERROR, "pressure 2 is frozen"),), _CLEAR, clear=("controller", "bridge")),
    # ---- who commands, and with what
    Fault("second commander", "10 V and 0 V, 500 times a second", second_commander((10.0, 0.0), 0.8), _ON,
          (Wanted("bridge: commands", _ERROR, "commands refused"),), _KEPT),
    Fault("disk full", "the recorder's writes fail", disk_full, _ON,
          (Wanted("recorder: bag", _ERROR, "the recording has ended"),), _KEPT, lasts=0.2),
    Fault("rig file makes no sense", "estimator started with it",
          wrong_rig("estimator", "supply: {pressure: -1.0}", runs=False), _SAFE, (_NO_ESTIMATES,), _RESTART),
    # The pressures cannot show these: what the nodes tell about their files does.
    Fault("rig file of another joint", "estimator started with it: supply of 400 kPa",
          wrong_rig("estimator", "supply: {pressure: 400.0e+3}"), _SAFE,
          (Wanted("controller: commands", _ERROR, "the rig file of the estimator"),), _CLEAR, clear=("controller",)),
    Fault("rig file of other valves", "bridge started with it: inflow areas ten times as large",
          wrong_rig("bridge", "valve_1: {inflow_area: 5.184e-7}\nvalve_2: {inflow_area: 5.184e-7}"), _SAFE,
          (Wanted("controller: commands", _ERROR, "the rig file of the bridge"),), _CLEAR, clear=("controller",)),
    Fault("rig file with refined values", "estimator started with it: areas off by 10 %, a leak",
          wrong_rig("estimator", "valve_1: {inflow_area: 5.7e-8}\neffects: {leak: {area_1: 1.0e-10}}"), _ON,
          (Wanted("controller: rig", _OK, "the same joint; estimator with other values"),), _KEPT),
    Fault("rig file of another device", "bridge started with it: 250 Hz",
          wrong_rig("bridge", "sample_period: 0.004"), _SAFE,
          (Wanted("bridge: device", _ERROR, "samples every 1 ms"),
           Wanted("controller: rig", _ERROR, "sample_period 0.004 s rather than 0.001 s")), _CLEAR,
          clear=("controller",)),
    Fault("two pipelines", "another one in /left/elbow; its controller killed", neighbour, _ON, (), _KEPT),
    # ---- messages
    Fault("messages lost", "20 % of pressure 1, estimates and commands", messages("drop=0.2", RELAYED), _ON,
          (Wanted("estimator: samples", _WARN, "incomplete"),), lasts=1.0, bench="relayed"),
    Fault("messages twice", "all of the same", messages("double", RELAYED), _ON,
          # whichever of two pressures completes its sample first leaves the other one too late for it
          (Wanted("estimator: samples", _OK, "duplicate messages or messages too late for their sample", True),),
          _KEPT, lasts=1.0, bench="relayed"),
    Fault("pressure late", "pressure 1 by 100 ms", messages("late=0.1", ("pressure_1",)), _SAFE,
          (Wanted("controller: commands", _ERROR, "without pressure 1"),), _CLEAR, clear=("controller",),
          bench="relayed"),
    Fault("estimates late", "by 100 ms", messages("late=0.1", ("joint_estimate",)), _SAFE,
          (Wanted("controller: commands", _WARN, "late"),), bench="relayed"),
    Fault("commands late", "by 100 ms", messages("late=0.1", ("valve_command",)), _SAFE,
          (Wanted("bridge: commands", _WARN, "late"),), bench="relayed"),
    # ---- time
    # For 0.3 s the bridge listens to the device's clock anew, and has no stamps for its samples.
    Fault("machine's clock set back", "by 5 s, with device and bridge", clock_set_back(5.0), _SAFE,
          (Wanted("bridge: clock", _WARN, "listens"), Wanted("controller: commands", _WARN, "jumped backwards")),
          lasts=0.2, bench="stepped"),
    Fault("machine's clock set ahead", "by 5 s, with device and bridge", clock_set_back(-5.0), _SAFE,
          (Wanted("bridge: clock", _WARN, "listens"),), lasts=0.2, bench="stepped"),
)  # fmt: skip
"""All of them; those of one pipeline stand together."""
