"""The result of ``identify`` on a sealed joint, and its page."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from typing_extensions import override

from pam_antagonist.identification.sealed import SealedIdentified
from pam_antagonist.identification.sealed_tuning import drift_size
from pam_antagonist.report.assumption import assumption, in_first_lines
from pam_antagonist.report.document import Block, Document, Section, Text, Tile, Tiles, background, words
from pam_antagonist.report.held_out import entry, held_out_table
from pam_antagonist.report.identify import IdentifyResult
from pam_antagonist.report.identify_findings import do_not_use, rejection
from pam_antagonist.report.replay_figures import replay_figures
from pam_antagonist.report.result import picked
from pam_antagonist.report.table import MISSING, Table, number, percent
from pam_antagonist.report.units import readable, unit_of
from pam_antagonist.rig import Rig
from pam_antagonist.rig.write import refusal
from pam_antagonist.software import versions

ASSUMED = (
    "The volume of each muscle at angle 0 and the polytropic index: closed chambers determine k_2 (dV/dl)/V only.",
    "The force map: a sealed joint determines the difference of the two muscles' forces only, not how a force grows "
    "with pressure.",
    "The inertia, and whatever else does not matter in slow motion.",
    "The charge: at angle 0 it stays the same while the muscles are closed. Pressures alone do not distinguish an "
    "angle from a difference in charge.",
)
_TERMS = ("Held out", "As configured", "UKF", "RMSE 𝕀, ratio ℚ", "Standard error")
_DRIFT_TIME = "effects.pressure_sensor.drift_time"
_WALK = "effects.external_torque.noise"


@dataclass(frozen=True, eq=False, repr=False)
class SealedIdentifyResult(IdentifyResult):
    """An identified rig of a sealed joint."""

    _ABOUT: ClassVar[tuple[str, ...]] = ()

    @property
    def sealed(self) -> SealedIdentified:
        """All results."""
        assert isinstance(self.found, SealedIdentified)
        return self.found

    @override
    @cached_property
    def rejected(self) -> str:
        return rejection(self.held, refusal(self.rig))

    @property
    @override
    def warnings(self) -> tuple[str, ...]:
        return ()

    @property
    @override
    def lacks_an_effect(self) -> bool:
        return False

    def _values_of(self, stage: Any) -> dict[str, dict[str, Any]]:
        start, std = self.sealed.start, stage.std
        return {
            name: {"before": start.value(name), "after": after, "std": std.get(name), "unit": unit_of(start, name)}
            for name, after in stage.values.items()
        }

    def _both(self, what: Callable[[Rig], Any]) -> dict[str, Any]:
        return {"before": what(self.sealed.start), "after": what(self.sealed.rig)}

    @cached_property
    def tuning(self) -> dict[str, Any]:
        """The filter's tuning before and after, in squared SI units of readings and states.

        The random walk is the noise of the external torque [N m/√s]; the likelihood is that of the angle's errors,
        minus the square of ln(NIS/2).
        """
        likelihood = self.sealed.likelihood
        return {
            "measurement": self._both(lambda rig: tuple(rig.tuning("default").measurement)),
            "process": self._both(lambda rig: tuple(rig.tuning("default").process)),
            "drift_std_pa": self._both(_drift),
            "drift_time_s": self._both(lambda rig: rig.value(_DRIFT_TIME)),
            "random_walk": self._both(lambda rig: rig.value(_WALK)),
            "log_likelihood": {"before": likelihood[0], "after": likelihood[1]},
            "evaluations": self.sealed.evaluations,
        }

    @override
    def to_json(self) -> dict[str, Any]:
        return {
            "held_out": [entry(held) for held in self.held],
            "stages": [
                {"name": stage.name, "values": self._values_of(stage), **picked(stage, "residual", "unit", "note")}
                for stage in self.sealed.stages
            ],
            "tuning": self.tuning,
            "assumed": ASSUMED,
            "recordings": [
                {
                    "name": held.name,
                    "sha256": held.whole.report.recording.sha256,
                    "duration_s": held.whole.report.duration_s,
                    "fitted_until_s": held.from_s,
                }
                for held in self.held
            ],
            "software": versions(),
            "assumption": assumption(self.sealed.start, identified=True),
            "rejected": self.rejected,
        }

    @override
    def _values(self) -> list[tuple[Any, ...]]:
        return [
            (name, item["before"], item["after"], item["std"])
            for stage in self.sealed.stages
            for name, item in self._values_of(stage).items()
        ]

    @override
    def _fitted(self) -> list[str]:
        return [f"first {until:.1f} s" for until in self.sealed.held_from]

    def _first_lines(self) -> tuple[Text, ...]:
        return in_first_lines(assumption(self.sealed.start, identified=True))

    def _do_not_use(self) -> list[Block]:
        return [Text(do_not_use(self.rejected), "verdict")] if self.rejected else []

    @override
    def blocks(self) -> tuple[Block, ...]:
        return *self._do_not_use(), *self._first_lines(), self._values_table(), *map(held_out_table, self.held)

    @override
    def document(self, figures: bool = True) -> Document:
        ukf = self.held[0].identified.ukf
        lede = Text("A joint whose muscles are sealed: no air flows, an external torque moves it.", "lede")
        parts: list[Block] = [lede, *self._do_not_use()]
        tiles = []
        if ukf.angle is not None:
            text = (
                f"On held-out data the filter's angle error is {ukf.angle.rmse:.2f}° (RMS), from the two pressures "
                f"alone. The largest error is {percent(ukf.angle.ratio)} of the range. "
                f"{percent(ukf.angle.coverage95)} of the angles lie in their 95 % interval."
            )
            parts.append(Text(text, "verdict"))
            tiles.append(Tile("Angle error (RMS)", f"{ukf.angle.rmse:.3f}°", "from pressures alone, held-out part"))
        if ukf.external_torque is not None and math.isfinite(ukf.external_torque.rmse):
            note = "estimated by the filter; where the joint sticks, friction hides it"
            tiles.append(Tile("External torque (RMS)", f"{ukf.external_torque.rmse:.2f} N m", note))
        content: list[Block] = []
        for place, held in enumerate(self.held):
            drawn = replay_figures(held.whole, held.from_s) if figures else ()
            if place == 0:
                parts, drawn = [*parts, *drawn[:1]], drawn[1:]
            content += [held_out_table(held), *drawn]
        stages = self.sealed.stages
        steps = tuple((stage.name, f"{number(stage.residual)} {stage.unit}", stage.note) for stage in stages)
        recordings = [
            (f"Recording {item['name']}", f"{item['duration_s']:.1f} s, fitted to {item['fitted_until_s']:.1f} s; "
             f"SHA-256 {item['sha256']}")
            for item in self.to_json()["recordings"]
        ]  # fmt: skip
        parts += [
            *self._first_lines(),
            Tiles(tuple(tiles)),
            Section("On held-out data", tuple(content), 2, "held-out"),
            Section("Parameters", (self._values_table(),), 2, "parameters"),
            Section("Step by step", (Table(("Step", "residual (RMS)", "note"), steps, prose=True),), folded=True),
            Section("Tuning", self._tuning_blocks(), folded=True),
            Section("What is assumed", tuple(Text(text) for text in ASSUMED), folded=True),
            *background([item for item in words("identify") if item[0] in _TERMS], recordings),
        ]
        return Document("Identification of a sealed muscle joint", f"Rig {self.rig.name}", tuple(parts))

    def _tuning_blocks(self) -> tuple[Block, ...]:
        text = (
            "R is the noise of the pressures. The other values maximise the likelihood of the errors of the measured "
            "angle on the fitted part, while the innovations are as large as the filter expects. The drift of the "
            "readings is a state of its own, and not in R."
        )
        rows = []
        for name, key, place in (
            ("R [Pa²]", "measurement", 0), ("Drift of the readings, std. dev. [Pa]", "drift_std_pa", None),
            ("Its time constant [s]", "drift_time_s", None), ("Q of the velocity, a step [rad²/s²]", "process", 1),
            ("Q of a pressure, a step [Pa²]", "process", 2),
            ("Random walk of the torque [N m/s^0.5]", "random_walk", None),
        ):  # fmt: skip
            both = [self.tuning[key][when] for when in ("before", "after")]
            rows.append((name, *(number(value if place is None else value[place], 3) for value in both)))
        return Text(text), Table(("", "as configured", "identified"), tuple(rows))

    def _values_table(self) -> Table:
        """The identified parameters."""
        rows = tuple(
            (
                f"{name} [{unit.name}]",
                number(item["before"] * unit.scale, 5),
                number(item["after"] * unit.scale, 5),
                MISSING if item["std"] is None else number(item["std"] * unit.scale, 2),
            )
            for stage in self.sealed.stages
            for name, item in self._values_of(stage).items()
            for unit in [readable(item["unit"])]
        )
        return Table(("Parameter", "as configured", "identified", "standard error"), rows)


def _drift(rig: Rig) -> float:
    """Standard deviation of the drift of the pressure readings, the larger of both [Pa]."""
    noise = max(rig.value(f"effects.pressure_sensor.drift_{muscle}") for muscle in (1, 2))
    return drift_size(noise, rig.value(_DRIFT_TIME))
