"""``python -m validation NAME ...`` or ``./run NAME ...``: measurements of the product, from a checkout."""

from __future__ import annotations

import sys

from pam_antagonist.__main__ import Command, main

COMMANDS: dict[str, Command] = {
    "paper": Command("validation.paper.command:main", "repeat every experiment of the paper on simulated joints"),
    "benchmark": Command("validation.benchmark.command:main", "measure the speed of estimator, pipeline and replay"),
    "battery": Command("validation.battery.command:main", "measure how often close_loop is right, on simulated joints"),
    "forms": Command(
        "validation.battery.carry:main", "measure whether what close_loop learns holds on a third recording"
    ),
    "oracle": Command("validation.oracle:main", "run close_loop on cases whose answer is frozen, say what got worse"),
    "peers": Command("validation.peers.command:main", "compare ours with soft sensors, other filters and fitted laws"),
    "ambiguity": Command("validation.ambiguity:main", "show which missing effects look alike, on simulated joints"),
    "rehearse_new_rigs": Command(
        "validation.rigs.rehearsed:main",
        "run commission on twelve rigs of new_rig and joints drawn from their priors",
    ),
    "rigs": Command("validation.rigs.fresh:main", "identify fresh virtual rigs and judge the result"),
    "days": Command("validation.rigs.days:main", "follow fresh virtual rigs that drift from day to day, with adapt"),
    "monitor_study": Command(
        "validation.monitor_study:main", "measure what the monitor finds, how late, and how often it alarms for nothing"
    ),
    "pamy": Command("validation.pamy:main", "apply close_loop to the recording of a real arm with regulators"),
    "arm_networks": Command(
        "validation.peers.aged:main", "compare our model of a real arm with networks that weigh episodes by age"
    ),
    "broken": Command("validation.broken:main", "break behaviours in a copy, count how many the tests notice"),
    "device_emulator": Command(
        "validation.device.command:main", "emulate a rig's microcontroller, with a simulated joint"
    ),
    "faults": Command(
        "validation.faults.command:main",
        "make every fault in a running pipeline and report what the valves did",
    ),
}
"""Name of a measurement -> description."""

PLACES = {"Benchmarks and validation": "validation."}

if __name__ == "__main__":
    sys.exit(main(None, COMMANDS, PLACES))
