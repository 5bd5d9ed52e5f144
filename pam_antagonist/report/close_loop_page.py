"""``report.html`` of ``close_loop``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pam_antagonist.diagnosis.result import Diagnosis
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.report import close_loop_figures as drawn
from pam_antagonist.report import close_loop_residuals as residuals
from pam_antagonist.report import close_loop_sealed as sealed
from pam_antagonist.report import close_loop_tables as tables
from pam_antagonist.report import html
from pam_antagonist.report.document import Block, Definitions, Document, Finding, Findings, Section, Text, Tile, Tiles
from pam_antagonist.report.table import Table, number, percent

_DEFINITIONS = (
    ("As configured", "the model with the numbers of the rig file."),
    ("Recalibrated", "the same model with its base parameters fitted, so that a wrong number is not called an effect."),
    ("Extended", "the recalibrated model with the effects that were found."),
    (
        "Held out",
        "the end of each recording, or whole recordings, which no fit has seen. All errors here are counted there.",
    ),
    ("Residual", "measurement minus model. Both are averaged over 20 samples."),
    (
        "ΔBIC",
        "evidence: twice the gain in log likelihood less what the further unknowns cost. It counts independent "
        "errors, told from the residual's autocorrelation, not samples. Above 6 is strong.",
    ),
    (
        "Held-out share",
        "how much of the squared residual beyond the sensors' noise goes away on held-out data with the effect.",
    ),
    ("Estimator", "the filter that runs live and knows the two pressures only."),
)


def write_report(folder: Path, document: dict[str, Any], found: Diagnosis, with_figures: bool = True) -> None:
    """Write ``report.json`` and ``report.html`` into a folder that exists.

    Args:
        folder: where to.
        document: of :func:`pam_antagonist.report.close_loop.document`.
        found: the diagnosis.
        with_figures: False leaves the figures out of the page.
    """
    html.write(folder, page(document, found, with_figures), document)


def page(document: dict[str, Any], found: Diagnosis, with_figures: bool = True) -> Document:
    """The report as a page."""
    lede = (
        "The model of this joint was compared with what was measured. What it misses was traced to a physical effect, "
        "if one explains it on data that no fit has seen."
    )
    title = {"effect": "An effect was found", "none": "Nothing is missing", "unexplained": "Unexplained"}[found.verdict]
    if found.verdict == "effect":
        title = "Found: " + ", ".join(dict.fromkeys(effect.name.replace("_", " ") for effect in found.effects))
    parts: list[Block] = [
        Text(lede, "lede"),
        Text(document["sentence"], "verdict"),
        Tiles(_tiles(document)),
        Findings(_findings(document)),
        tables.before_after(document),
    ]
    if with_figures:
        parts.append(Section("Residual before and after", drawn.residuals(found), 2, "residual"))
    parts.append(Section("Residuals", residuals.statistics(document, with_figures), 2, "statistics"))
    parts.append(Section("Candidates", (tables.ranking(document), *_law(found)), 2, "candidates"))
    if found.effects:
        figures = drawn.profiles(document) if with_figures and document["profiles"] else ()
        section: tuple[Block, ...] = (tables.parameters(document), *figures)
        parts.append(Section("Parameters", section, 2, "parameters"))
    if found.remaining:
        parts.append(Section("What is left", residuals.left(found.remaining, with_figures), 2, "left"))
    parts += [
        Section("What was assumed", (Definitions(_assumed(document)),), folded=True),
        Section("What the words mean", (Definitions(_words(document)),), folded=True),
        Section("How this report was made", _provenance(document, found), folded=True),
    ]
    return Document("Closing the loop with measured data", title, tuple(parts))


def _tiles(document: dict[str, Any]) -> tuple[Tile, ...]:
    if sealed.is_driven(document):
        return sealed.tiles(document)
    errors = document["errors"]
    out = []
    if document["verdict"] == "effect":
        what = "of what is beyond noise on held-out data"
        out.append(Tile("Explained", percent(document["share_explained"]), what))
        out.append(Tile("Evidence", f"ΔBIC {sum(_evidence(document).values()):.0f}", "above 6 is strong"))
    for channel, key, unit in (("angle", "deg", "°"), ("torque", "nm", " N m")):
        if errors["extended"][channel] is not None:
            before, after = (errors[model][channel][f"rmse_{key}"] for model in ("recalibrated", "extended"))
            out.append(
                Tile(
                    f"{channel.capitalize()} error (RMS)", f"{number(after, 2)}{unit}", f"was {number(before, 2)}{unit}"
                )
            )
    before, after = (max(errors[model]["pressure"]["rmse_pa"]) / 1e3 for model in ("recalibrated", "extended"))
    out.append(Tile("Larger pressure error", f"{number(after, 2)} kPa", f"was {number(before, 2)} kPa"))
    return tuple(out)


def _evidence(document: dict[str, Any]) -> dict[str, float]:
    return {effect["name"]: effect["delta_bic"] for effect in document["effects"]}


def _findings(document: dict[str, Any]) -> tuple[Finding, ...]:
    out = [Finding("warn", _sentence(text)) for text in document["warnings"]]
    if sealed.is_driven(document):
        return (*out, *sealed.findings(document), *(Finding("note", text) for text in document["unseen"]))
    for name in document["ambiguous_with"]:
        out.append(Finding("warn", f"{name} would do as well. To tell: {document['experiments'][name]}."))
    if document["effects"] and not document["ambiguous_with"]:
        out.append(Finding("good", "No other candidate comes within strong evidence of what was found."))
    out += [Finding("note", text) for text in document["unseen"]]
    return tuple(out)


def _words(document: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    if not sealed.is_driven(document):
        return _DEFINITIONS
    own = dict(sealed.DEFINITIONS)
    return (*((name, own.pop(name, text)) for name, text in _DEFINITIONS), *own.items())


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _law(found: Diagnosis) -> tuple[Block, ...]:
    named = [CATALOGUE[name] for name in dict.fromkeys(effect.name for effect in found.effects)]
    if not named:
        return ()
    rows = tuple((item.name, f"{item.law} ({item.source}). {item.signature}") for item in named)
    return (Definitions(rows),)


def _assumed(document: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    if sealed.is_driven(document):
        return sealed.assumed(document)
    settings = document["settings"]
    return (
        ("Start", "Each recording begins at rest, with everything slow settled."),
        ("Base parameters", "Known to 5 % before the fit (the supply to 1 %), and each recording's own."),
        ("Sensors", "White noise, told from what changes between samples; their converters' steps likewise."),
        ("Errors of the model", "Gaussian, of unknown size for each channel, at least the sensor's noise."),
        (
            "Excess",
            "What is beyond the sensors' noise is counted second by second, in decibels; down to a tenth of the error "
            "counts as all of it: no law has quite the form of what is there.",
        ),
        (
            "Thresholds",
            f"ΔBIC {settings['strong_evidence']:g} to be taken at all; the first effect removes "
            f"{100 * settings['first_share']:.0f} % of the excess on held-out data, "
            f"a further one {100 * settings['further_share']:.0f} % of all of it, all together "
            f"{100 * settings['explained_share']:.0f} %. "
            "The ΔBIC is a matter of statistics; the shares are experience with simulated joints.",
        ),
        ("Catalogue", f"{', '.join(CATALOGUE)}. What is none of these can only be called unexplained."),
    )


def _provenance(document: dict[str, Any], found: Diagnosis) -> tuple[Block, ...]:
    settings = document["settings"]
    rows = [
        ("Rig", settings["rig"]),
        ("Source of its numbers", settings["rig_source"]),
        ("Seed", str(settings["seed"])),
        ("Held out", _held_out(settings["holdout"])),
    ]
    for part in document["recordings"]:
        role = "; held out" if part["role"] == "held out" else ""
        rows.append((f"Recording {part['recording']}", f"{part['joint']}{role}; SHA-256 {part['sha256']}"))
    rows += [(f"Time for {name}", f"{value:.1f} s") for name, value in document["timing"].items()]
    return (Table(("What", "Which"), tuple(rows), prose=True),)


def _held_out(what: float | list[str]) -> str:
    if isinstance(what, list):
        return f"{', '.join(what)}: whole recordings"
    return percent(what) + " at the end of each recording"
