"""The experiments by name, and how they are run: what repeats over seeds in parallel, then one after the other."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from validation.paper.result import Context, Result
from validation.paper.scenario import Scenario
from validation.paper.seed_work import SeedWork


class Experiment(NamedTuple):
    """An experiment of the paper.

    Attributes:
        module: in this package; its ``of_seed``, where it has one, is repeated over the virtual rigs.
        result: its function that puts everything together.
        repeated: whether it is repeated over the seeds.
        live: whether it starts ROS 2 nodes.
        summary: in a few words.
    """

    module: str
    result: str
    repeated: bool
    live: bool
    summary: str


EXPERIMENTS: Mapping[str, Experiment] = {
    "static": Experiment("static", "result", True, False, "force against pressure and length, (6) and (7)"),
    "kappa": Experiment("kappa", "result", True, False, "the valve curve by three steps"),
    "influence": Experiment("influence", "result", False, False, "Proposition 1 and the guideline"),
    "subsystems": Experiment("inputs", "subsystems_result", True, False, "which of the 18 subsystems are visited"),
    "profile": Experiment("inputs", "profile_result", True, False, "the input profile"),
    "offline": Experiment("offline", "result", True, False, "model alone against filter"),
    "online": Experiment("online", "result", False, True, "the live nodes on the same profile"),
    "compare_angle": Experiment("compare_angle", "result", True, False, "Table III"),
    "compare_torque": Experiment("compare_torque", "result", True, False, "Table IV, and a real force map"),
    "control": Experiment("control", "result", True, True, "sensor-less control"),
}
"""In the order of the report."""


@dataclass(frozen=True)
class Options:
    """How to run.

    Attributes:
        names: of the experiments.
        seeds: of the virtual rigs; figures and live runs show the first.
        jobs: processes.
        with_figures: False saves their time.
        short: live runs of 30 s and less.
        force_map: a real muscle's force map, or None.
    """

    names: Sequence[str]
    seeds: Sequence[int]
    jobs: int
    with_figures: bool = True
    short: bool = False
    force_map: Path | None = None


def of_seed(modules: Sequence[str], scenario: Scenario, seed: int) -> dict[str, Any]:
    """What each module says of one virtual rig; recordings and filters are shared among them.

    Args:
        modules: names of experiments.
        scenario: that the rig is drawn from.
        seed: of the rig.
    """
    work = SeedWork(scenario, seed)
    out = {}
    for name in modules:
        module = importlib.import_module(f"validation.paper.{name}")
        out[name] = module.of_seed(work)
    return out


def over_seeds(scenario: Scenario, options: Options, progress: Callable[[int], Any]) -> dict[str, list[Any]]:
    """Everything that repeats, by module: one entry a seed.

    Args:
        scenario: the scenario.
        options: names, seeds, jobs.
        progress: called with 1 for each seed that is done.
    """
    modules = list(dict.fromkeys(item.module for item in _chosen(options) if item.repeated))
    found: dict[str, list[Any]] = {name: [] for name in modules}
    if not modules:
        return found
    for entry in _each(modules, scenario, options):
        for name in modules:
            found[name].append(entry[name])
        progress(1)
    return found


def _each(modules: Sequence[str], scenario: Scenario, options: Options) -> Iterator[dict[str, Any]]:
    if options.jobs == 1:
        yield from (of_seed(modules, scenario, seed) for seed in options.seeds)
        return
    from joblib import Parallel, delayed

    tasks = (delayed(of_seed)(modules, scenario, seed) for seed in options.seeds)
    yield from Parallel(n_jobs=min(options.jobs, len(options.seeds)), return_as="generator")(tasks)


def _chosen(options: Options) -> list[Experiment]:
    return [EXPERIMENTS[name] for name in EXPERIMENTS if name in options.names]


def run(
    scenario: Scenario,
    options: Options,
    folder: Path,
    progress: Callable[[int], Any],
    log: Callable[[str], None],
) -> tuple[list[Result], dict[str, float]]:
    """Run the chosen experiments.

    Args:
        scenario: the scenario.
        options: which, and how.
        folder: for what live runs record meanwhile.
        progress: called with 1 for each seed that is done.
        log: called with a line for the user now and then.

    Returns:
        Results in the order of the table, and what each took [s]; ``seeds`` is what all shared.
    """
    begin = time.perf_counter()
    if any(item.repeated for item in _chosen(options)):
        log(f"{len(options.seeds)} virtual rigs, {min(options.jobs, len(options.seeds))} at a time")
    repeated = over_seeds(scenario, options, progress)
    took = {"seeds": time.perf_counter() - begin}
    work = SeedWork(scenario, options.seeds[0])
    results = []
    for name, item in EXPERIMENTS.items():
        if name not in options.names:
            continue
        begin = time.perf_counter()
        log(f"{name}: {item.summary}")
        context = Context(
            work=work,
            of_seeds=repeated.get(item.module, []),
            seeds=list(options.seeds),
            with_figures=options.with_figures,
            short=options.short,
            force_map=options.force_map,
            folder=folder,
            log=log,
        )
        module = importlib.import_module(f"validation.paper.{item.module}")
        results.append(getattr(module, item.result)(context))
        took[name] = time.perf_counter() - begin
    return results, took
