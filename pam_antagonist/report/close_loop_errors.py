"""Errors and residuals of the three models of ``close_loop``, with the keys of its ``report.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

from pam_antagonist.estimation.errors import ChannelErrors


@dataclass(frozen=True)
class Innovations:
    """Consistency of the estimator.

    Attributes:
        nis_mean: mean normalised innovation squared; 2 is right.
        whiteness_p: probability of such an autocorrelation in white innovations.
        largest_correlation: largest autocorrelation.
    """

    nis_mean: float
    whiteness_p: float
    largest_correlation: float


@dataclass(frozen=True)
class Errors:
    """Errors of one model on held-out data.

    Attributes:
        angle: None where it was not measured.
        torque: likewise.
        sliding: RMSE of the torque while the joint slides and while it sticks [N m], and the share of samples in which
            it slides; empty where the two were not separated.
        rmse_pa: of both pressures [Pa].
        mean_rmse_pa: of the mean of both pressures [Pa]; None where it was not judged.
        innovation: of the estimator; None of a model alone.
    """

    angle: ChannelErrors | None
    torque: ChannelErrors | None
    sliding: Mapping[str, float]
    rmse_pa: tuple[float, float]
    mean_rmse_pa: float | None
    innovation: Innovations | None

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Errors:
        """The errors of a diagnosis, which have the keys of ``report.json``."""
        torque, innovation = given["torque"], given.get("innovation")
        return cls(
            _channel(given["angle"], "deg"),
            _channel(torque, "nm"),
            {key: value for key, value in (torque or {}).items() if key not in _CHANNEL_KEYS},
            (given["pressure"]["rmse_pa"][0], given["pressure"]["rmse_pa"][1]),
            given["pressure"].get("mean_rmse_pa"),
            None if innovation is None else Innovations(**innovation),
        )

    def to_json(self) -> dict[str, Any]:
        """The keys that a diagnosis gives them."""
        mean = {} if self.mean_rmse_pa is None else {"mean_rmse_pa": self.mean_rmse_pa}
        out: dict[str, Any] = {
            "angle": self.angle,
            "torque": None if self.torque is None else {**self.torque.to_json(), **self.sliding},
            "pressure": {"rmse_pa": self.rmse_pa, **mean},
        }
        return out if self.innovation is None else {**out, "innovation": self.innovation}


_CHANNEL_KEYS = ("rmse_deg", "max_deg", "rmse_nm", "max_nm", "q", "coverage95")


def _channel(given: Mapping[str, float] | None, unit: Literal["deg", "nm"]) -> ChannelErrors | None:
    if given is None:
        return None
    return ChannelErrors(unit, given[f"rmse_{unit}"], given[f"max_{unit}"], given["q"], given.get("coverage95"))


@dataclass(frozen=True)
class ModelErrors:
    """Errors of the three models.

    Attributes:
        as_configured: the rig file's.
        recalibrated: with fitted base parameters.
        extended: with the effects as well.
    """

    as_configured: Errors
    recalibrated: Errors
    extended: Errors

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> ModelErrors:
        """The errors of a diagnosis."""
        return cls(*(Errors.of(given[item.name]) for item in fields(cls)))

    @property
    def all(self) -> tuple[Errors, Errors, Errors]:
        """In the order of the table's columns."""
        return self.as_configured, self.recalibrated, self.extended


@dataclass(frozen=True)
class Relation:
    """Correlation of a residual with a signal that comes before it.

    Attributes:
        lag_s: by which the signal comes before [s].
        correlation: at that lag.
        z: the same in standard deviations.
        limit: size of z that chance alone exceeds once in twenty times.
        p: probability of such a size by chance.
    """

    lag_s: float
    correlation: float
    z: float
    limit: float
    p: float

    @property
    def over_chance(self) -> float:
        """Size relative to the one that chance alone exceeds once in twenty times, with its sign."""
        return self.z / self.limit


@dataclass(frozen=True)
class ResidualRow:
    """A residual of a model on held-out data.

    Attributes:
        channel: sensor, equation or innovation.
        kind: ``sensor``, ``equation`` or ``innovation``.
        unit: of the residual.
        rms: root mean square.
        noise: that of the sensors' noise.
        above_noise: share of the mean square that the sensors' noise does not explain.
        memory_s: time between independent values [s].
        independent: number of independent values.
        whiteness_p: probability of such an autocorrelation in white noise; None where there are too few values.
        relations: by signal.
    """

    channel: str
    kind: str
    unit: str
    rms: float
    noise: float
    above_noise: float
    memory_s: float
    independent: float
    whiteness_p: float | None
    relations: Mapping[str, Relation]

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> ResidualRow:
        """The row of a diagnosis."""
        relations = {name: Relation(**item) for name, item in given["relations"].items()}
        return cls(**{**given, "relations": relations})

    @property
    def title(self) -> str:
        """The channel's name."""
        return self.channel.replace("_", " ")
