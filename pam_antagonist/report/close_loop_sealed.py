"""What the report of ``close_loop`` says of a sealed joint otherwise than of one that valves drive.

A recording's ``errors`` then have, of the torque, also ``rmse_sliding_nm``, ``rmse_sticking_nm``, ``sliding_share``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pam_antagonist.report.document import Finding, Tile
from pam_antagonist.report.table import number, percent

Document = Mapping[str, Any]
Rows = list[tuple[str, list[float | None] | None]]
_MODELS = ("as_configured", "recalibrated", "extended")

DEFINITIONS = (
    (
        "Recalibrated",
        "the base model fitted as `identify` does, with the Coulomb friction taken out: the loop that it makes may be "
        "that of the drive, of the joint or of the muscles, so that whatever makes it has to prove itself.",
    ),
    (
        "Torque from outside",
        "what the drive was told to apply. The model's is what the measured motion needs: equation (8), solved for it, "
        "with the measured angle and the pressures of the closed chambers. The estimator's is what it makes of the "
        "two pressures alone.",
    ),
    (
        "Sliding, sticking",
        "faster or slower than 0.02 rad/s. While a joint sticks, friction may be anything up to its bound, so that no "
        "model knows the torque: it takes friction with the sign of whatever trace of motion is in the measured "
        "angle. An angle that was low-passed without a phase shift, as a recording may be, foretells a little there.",
    ),
    ("Mean pressure", "of both muscles: free of the encoder's error, which moves the two pressures apart."),
)
ABOUT_RESIDUALS = (
    "On held-out data: measurement minus model, the model driven by the measured angle. A residual is compared with "
    "what was there up to 2 s before it."
)


def is_driven(document: Document) -> bool:
    """Whether the joint was driven by its measured angle."""
    return any(part["joint"] == "driven" for part in document["recordings"])


def rows(document: Document) -> Rows:
    """Rows of the table of errors: name and the three models' values, None for a heading."""
    errors = document["errors"]
    out: Rows = [("AngleDriven by the measured angle", None)]
    if errors["extended"]["torque"] is not None:
        for name, key in (
            ("torque from outside", "rmse_nm"),
            ("  while it slides", "rmse_sliding_nm"),
            ("  while it sticks", "rmse_sticking_nm"),
        ):
            values = [errors[model]["torque"].get(key) for model in _MODELS]
            if any(value is not None for value in values):
                out.append((f"  {name}, RMSE [N m]", values))
        out.append(("  torque, largest [N m]", [errors[model]["torque"]["max_nm"] for model in _MODELS]))
    out.append(("  mean pressure, RMSE [kPa]", [errors[model]["pressure"]["mean_rmse_pa"] / 1e3 for model in _MODELS]))
    for muscle in (0, 1):
        out.append(
            (
                f"  pressure {muscle + 1}, RMSE [kPa]",
                [errors[model]["pressure"]["rmse_pa"][muscle] / 1e3 for model in _MODELS],
            )
        )
    if errors["extended"]["angle"] is not None:
        out.append(("Model alone, under the torque from outside", None))
        out.append(("  angle, RMSE [°]", [errors[model]["angle"]["rmse_deg"] for model in _MODELS]))
    for part in document["recordings"]:
        if "ukf" not in part:
            continue
        out.append((f"Estimator from pressures alone, {part['recording']}", None))
        for channel, name, key, unit in (
            ("torque", "torque from outside", "rmse_nm", "N m"),
            ("angle", "angle", "rmse_deg", "°"),
        ):
            if part["ukf"]["extended"][channel] is not None:
                out.append((f"  {name}, RMSE [{unit}]", [part["ukf"][m][channel][key] for m in _MODELS]))
    return out


def tiles(document: Document) -> tuple[Tile, ...]:
    """The figures on the first screen."""
    errors, out = document["errors"], []
    found = {effect["name"]: effect["delta_bic"] for effect in document["effects"]}
    if found:
        said = ", ".join(f"{value:.0f}" for value in found.values())
        out.append(Tile(f"ΔBIC of {', '.join(found)}", said, "above 6 is strong"))
    if errors["extended"]["torque"] is not None:
        before, after = (errors[model]["torque"]["rmse_nm"] for model in ("recalibrated", "extended"))
        reference = document["reference"]["angle_and_pressures"]
        note = f"was {number(before, 2)}; a straight-line map: {number(reference, 2)}"
        out.append(Tile("Torque error, measured angle", f"{number(after, 2)} N m", note))
    ukf = document["recordings"][0].get("ukf")
    if ukf is not None:
        for channel, title, key, unit in (
            ("torque", "Torque error, pressures alone", "rmse_nm", " N m"),
            ("angle", "Angle error, pressures alone", "rmse_deg", "°"),
        ):
            if ukf["extended"][channel] is not None:
                before, after = (ukf[model][channel][key] for model in ("recalibrated", "extended"))
                note = f"was {number(before, 2)}; as configured {number(ukf['as_configured'][channel][key], 2)}"
                out.append(Tile(title, f"{number(after, 2)}{unit}", note))
    before, after = (errors[model]["pressure"]["mean_rmse_pa"] / 1e3 for model in ("recalibrated", "extended"))
    out.append(Tile("Error of the mean pressure", f"{number(after, 2)} kPa", f"was {number(before, 2)} kPa"))
    return tuple(out)


def findings(document: Document) -> tuple[Finding, ...]:
    """What was compared on equal terms, and what would tell."""
    out = []
    compared = {item["other"]: item for item in document["ambiguities"]}
    for name in document["ambiguous_with"]:
        item = compared.get(name)
        if item is None:
            text = f"{name.capitalize()} would do as well. To tell: {document['experiments'][name]}."
            out.append(Finding("warn", text))
            continue
        mine, other = (number(value, 2) for value in item["residual"])
        out.append(
            Finding(
                "warn",
                f"{name.capitalize()} would do as well as {item['found']}: compared {item['about']}, "
                f"{item['found']} leaves {mine} and {name} {other} {item['unit']} (ΔBIC {item['evidence']:.1f}). "
                f"{_size(item)}"
                f"To tell: {document['experiments'][name]}.",
            )
        )
    for item in document["ambiguities"]:
        if not item["ambiguous"]:
            mine, other = (number(value, 2) for value in item["residual"])
            out.append(
                Finding(
                    "good",
                    f"{item['other'].capitalize()} would not do as well as {item['found']}: {item['found']} leaves "
                    f"{mine} and {item['other']} {other} {item['unit']} (ΔBIC {item['evidence']:.1f}).",
                )
            )
    torques = [document["errors"][model]["torque"] or {} for model in ("as_configured", "extended")]
    before, after = (torque.get("rmse_sliding_nm") for torque in torques)
    if document["effects"] and before is not None and after is not None and before < after:
        out.append(
            Finding(
                "note",
                f"While the joint slides, the rig as configured errs less ({number(before, 2)} N m): `identify` fits "
                "sliding alone. Here all samples count, and sticking, which no law foretells, pulls at the fit "
                f"({number(after, 2)} N m).",
            )
        )
    parts = {part["name"]: part["verdict"] for part in document["parts"]}
    if "effect" in parts.values():
        for name in (name for name, verdict in parts.items() if verdict == "unexplained"):
            out.append(Finding("warn", f"What the {name} leave is beyond noise, and no effect explains it."))
    if document["base_friction_removed"] and "torque" in parts:
        out.append(
            Finding(
                "note",
                "The rig file has Coulomb friction already. It was taken out before anything was tested: what makes "
                "the loop in the torque had to prove itself. The extended rig has it as an effect instead.",
            )
        )
    return tuple(out)


def _size(item: Mapping[str, Any]) -> str:
    """What the found effect's size is where the two were compared."""
    if item["size"] is None:
        return ""
    unit = "N m" if item["found"] == "friction" else "N"
    return f"Fitted there alone, {item['found']} is {number(item['size'], 2)} {unit}. "


def assumed(document: Document) -> tuple[tuple[str, str], ...]:
    """What was taken for granted."""
    settings = document["settings"]
    return (
        ("Input", "The measured angle; smoothed at 3 Hz without a phase shift where it has noise of its own."),
        ("Volume and force", "As the rig file declares them, but for what `identify` finds of a sealed joint."),
        (
            "Sensors",
            "The pressures' noise is told from what changes between samples; the encoder's and the torque's are the "
            "rig file's, with what an error of the encoder moves.",
        ),
        ("Errors of the model", "Gaussian, of unknown size for each channel, at least the sensor's noise."),
        (
            "Thresholds",
            f"ΔBIC {settings['strong_evidence']:g} to be taken at all; all effects together remove "
            f"{percent(settings['explained_share'])} of the excess, fitted and held out together.",
        ),
    )
