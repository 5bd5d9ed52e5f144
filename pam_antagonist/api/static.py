"""``static``: fits of a muscle's static tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pam_antagonist.api.given import RigGiven
from pam_antagonist.errors import BadInput, number
from pam_antagonist.identification.static import work_out
from pam_antagonist.identification.static_table import Choice, read_force_map, read_volumes
from pam_antagonist.recording.plausible import STANDARD_ATMOSPHERE
from pam_antagonist.report.static import StaticResult
from pam_antagonist.rig import as_rig
from pam_antagonist.shown import widened

__all__ = ["StaticResult", "static"]


def static(
    rig: RigGiven | None,
    volume: str | Path | None = None,
    force_map: str | Path | None = None,
    *,
    muscles: tuple[int, ...] = (1, 2),
    form: str = "",
    columns: Mapping[str, Choice] | None = None,
    pressure: str = "",
    slack_below: float = 0.0,
    length: float | None = None,
    report_only: bool = False,
) -> StaticResult:
    """Fit a muscle's volume and force map to static measurements, as the command ``static`` does.

    Args:
        rig: that gets the coefficients: a rig, its name or its file; None for a muscle without a rig.
        volume: CSV file of length and volume.
        force_map: CSV file of length, pressure and force.
        muscles: that get the coefficients.
        form: of the force map; default: that of the rig.
        columns: column of each quantity, where the columns' names do not say it.
        pressure: ``gauge`` or ``absolute``, where the column's name does not say it.
        slack_below: largest force that counts as a slack muscle [N].
        length: muscle length at angle 0 [m]; default: that of the rig.
        report_only: True makes no rig; then the muscle need not fit the rig.

    Returns:
        The fits with their errors, and the rig with them.

    Raises:
        BadInput: no table, a table that cannot be read, or fits that no rig may have.

    Example:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from pam_antagonist import static
        >>> rows = ["length_mm,volume_cm3", "150,48.1", "160,54.6", "165,57.4", "170,59.9", "180,64.1"]
        >>> with TemporaryDirectory() as folder:
        ...     table = Path(folder) / "cylinder.csv"
        ...     _ = table.write_text(chr(10).join(rows))
        ...     fitted = static("shin2022", table, report_only=True)
        >>> fitted.volume.form.name
        'volume'
    """
    if volume is None and force_map is None:
        raise BadInput("volume, force_map: expected one of them at least")
    if length is not None and not 0.02 < number("length", length) < 2.0:
        raise BadInput(f"length {length:g} m: expected the muscle's length at angle 0, 0.02 to 2 m")
    given, chosen = None if rig is None else as_rig(rig, regulators=True), dict(columns or {})
    air = STANDARD_ATMOSPHERE if given is None else given.atmosphere.pressure
    volumes = None if volume is None else read_volumes(Path(volume), chosen)
    forces = None if force_map is None else read_force_map(Path(force_map), air, chosen, pressure, slack_below)
    found = work_out(given, volumes, forces, muscles, form, length or 0.0, report_only)
    return widened(StaticResult, found)
