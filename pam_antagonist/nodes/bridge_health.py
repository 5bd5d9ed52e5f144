"""Health of the bridge's device for ``/diagnostics`` (without ROS)."""

from __future__ import annotations

import math
from collections.abc import Mapping

from pam_antagonist.hardware.device import Device
from pam_antagonist.hardware.link import Link
from pam_antagonist.nodes.health import Health, Level, Rate

_TROUBLE = (
    "damaged frames from the device",
    "damaged frames at the device",
    "commands refused by the device",
    "watchdog trips of the device",
)
"""Counters of a device that cause a warning when they rise."""


class BridgeHealth:
    """Parts ``device`` and ``clock``."""

    def __init__(self, link: Link, device: Device) -> None:
        self._link = link
        self._device = device
        self._rate = Rate()
        self._before: dict[str, float] = {}

    def parts(self, steady_ns: int) -> Mapping[str, Health]:
        """The health of both parts; called every ``diagnostics_period`` with the steady time [ns]."""
        return {"device": self._of_device(steady_ns), "clock": self._of_clock()}

    def _of_device(self, steady_ns: int) -> Health:
        link, counts = self._link, self._link.counts
        info, trouble = link.info, link.trouble
        counters = dict(self._device.counters())
        watched = {name: counters[name] for name in _TROUBLE if name in counters and math.isfinite(counters[name])}
        watched["samples lost"] = float(counts.lost)
        watched["devices lost"] = float(counts.lost_devices)
        # The first value of a counter is only the baseline: the device may have counted before.
        more = {name: value - self._before.get(name, value) for name, value in watched.items()}
        self._before = watched
        risen = [f"{name}: {change:g} more" for name, change in more.items() if change > 0]
        if trouble:
            level, message = Level.ERROR, f"no device: {trouble}"
        elif info is not None and info.watchdog_ns is None:
            level, message = Level.WARN, "this device does not become safe by itself when this process dies"
        elif risen:
            level, message = Level.WARN, ", ".join(risen)
        else:
            level, message = Level.OK, "running"
        values: dict[str, object] = {
            "name": "none" if info is None else info.name,
            "rate [Hz]": f"{self._rate.take(counts.samples, steady_ns):.1f}",
            "samples": counts.samples,
            "samples lost": counts.lost,
            "samples before the clocks were known": counts.without_stamp,
            "samples with the device's own safe voltages": counts.safe_by_itself,
            "devices lost": counts.lost_devices,
        }
        values |= {name: f"{value:.6g}" for name, value in counters.items()}
        return Health(level, message, values)

    def _of_clock(self) -> Health:
        link = self._link
        clock = link.clock
        values: dict[str, object] = {
            "drift [ppm]": f"{clock.drift * 1e6:.2f}",
            "samples left out, backwards": link.counts.backwards,
            "restarts of the map": link.clock_restarts + clock.restarts,
            "steps of the host's clock": link.counts.clock_steps,
        }
        if link.info is None:
            return Health(Level.WARN, "no device", values)
        if not clock.ready:
            return Health(Level.WARN, "listens to the device's clock before it stamps", values)
        values["offset [s]"] = f"{clock.offset_s:.6f}"
        return Health(Level.OK, "mapped to ROS time", values)
