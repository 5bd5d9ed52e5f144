"""Findings and assumptions of ``close_loop`` in sentences, from its numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.result import Ambiguity
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.report.document import Finding, good, note, number, warn, words

if TYPE_CHECKING:
    from pam_antagonist.diagnosis.closed_loop import ClosedLoop


def findings(result: ClosedLoop) -> tuple[Finding, ...]:
    """Findings in addition to the verdict."""
    out = [warn(sentence(text)) for text in result.warnings]
    rivals = {item.other: item for item in result.ambiguities if item.ambiguous}
    for name in result.ambiguous_with:
        text = f"{_title(name)} would explain the data as well{_compared(rivals.get(name))}."
        out.append(warn(f"{text} To distinguish them: {result.experiment[name]}."))
    for item in result.ambiguities:
        if not item.ambiguous:
            out.append(good(f"{_title(item.other)} explains the data less well{_compared(item)}."))
    if result.effects and not result.ambiguous_with and not any(effect.alternatives for effect in result.effects):
        out.append(good("No other candidate explains the data nearly as well as what was found."))
    slides = [model.sliding for model in (result.errors.as_configured, result.errors.extended)]
    before, after = (None if item is None else item.rmse_sliding_nm for item in slides)
    if result.effects and before is not None and after is not None and before < after:
        out.append(note(
            f"While the joint slides, the rig as configured has the smaller error ({number(before, 2)} N m, extended "
            f"{number(after, 2)} N m). The reason: identify fits only the samples in which the joint slides. Here all "
            "samples count, and no law predicts the torque while the joint sticks."
        ))  # fmt: skip
    out += [
        warn(f"The residual of the {part.name} is above noise, and no effect explains it.")
        for part in result.parts
        if result.effects and part.verdict == "unexplained"
    ]
    if result.base_friction_removed and any(part.name == "torque" for part in result.parts):
        out.append(note(
            "The rig file has Coulomb friction. It was removed before the test, so that every cause of a hysteresis "
            "loop was tested. The extended rig has friction as an effect instead."
        ))  # fmt: skip
    return tuple(out)


def calibration_findings(result: ClosedLoop) -> tuple[Finding, ...]:
    """The calibrations that the recordings need, with command line options."""
    if not result.calibrations:
        return ()
    what = sentence("; ".join(item.in_words() for item in result.calibrations))
    if not result.corrections:
        return (warn(f"{what} Together with the options given, that is too much."),)
    text = f"{what} To correct that, add `{' '.join(result.corrections)}` to every command that reads these recordings."
    return (warn(f"{text} An extended rig file has it already: then the options are not needed."),)


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _compared(item: Ambiguity | None) -> str:
    """The numbers behind a comparison under equal conditions."""
    if item is None:
        return ""
    mine, other = (number(value, 2) for value in item.residual)
    text = (
        f" {'as' if item.ambiguous else 'than'} {item.found}: {item.found} leaves {mine} {item.unit}, {item.other} "
        f"{other} {item.unit} (RMS; ΔBIC {item.evidence:.1f}). They were compared {item.about.rstrip('.')}"
    )
    if item.size == item.size and item.ambiguous:
        text += f". In this comparison, {item.found} is {number(item.size, 2)} {item.size_unit}"
    return text


def sentence(text: str) -> str:
    """A sentence; the name of an effect or a recording keeps its first letter."""
    first = text.split(" ", 1)[0]
    named = first.endswith(":") or "/" in first or "_" in first
    return f"{text[:1] if named else text[:1].upper()}{text[1:].rstrip('.')}."


def assumed(result: ClosedLoop) -> tuple[tuple[str, str], ...]:
    """Assumptions of the diagnosis."""
    needed = (
        f"An effect needs a ΔBIC of {thresholds.STRONG:g}. The first effect has to explain "
        f"{100 * thresholds.FIRST_SHARE:.0f} % of the excess over noise on held-out data. Each further effect has to "
        f"explain {100 * thresholds.FURTHER_SHARE:.0f} % of the whole excess, and all effects together "
        f"{100 * thresholds.EXPLAINED:.0f} %. The threshold of the ΔBIC comes from statistics, the shares from "
        "simulated joints."
    )
    page = "close_loop of a driven joint, assumed" if result.driven else "close_loop, assumed"
    tried = {item.effect for item in result.ranking}
    tested = ", ".join(name for name in CATALOGUE if name in tried)
    catalogue = ("Catalogue", f"{tested}. Anything else is a law that is measured, or unexplained.")
    return *words(page), ("Thresholds", needed), *(() if result.driven else (catalogue,))
