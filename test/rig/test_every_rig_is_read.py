"""Each rig file that the package writes is accepted by everything that reads one, and has the laws of real joints."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.cli import new_rig
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.estimation.model_run import simulate_model
from pam_antagonist.inference.free_parameters import base_directions, free_parameters, moved
from pam_antagonist.model import parameters as par
from pam_antagonist.model.flow import valve_flow
from pam_antagonist.paths import config_dir
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.file import RefusedRig, refusal, write_rig
from pam_antagonist.rig.parts import muscle_parts, regulator_parts, valve_parts
from pam_antagonist.rig.physical import is_positive, varied
from pam_antagonist.rig.schema import limits

ROOT = Path(__file__).resolve().parents[2]
NUMBERS = [name for name in par.INDEX if name != "friction.time_step"]


def answers(muscle: str, drive: str, part: str) -> list[str]:
    """What a laboratory types whose joint has this muscle and this valve or regulator."""
    size = int(muscle.rpartition("-")[2])
    given = {
        "radius": f"{1.2 * size}mm", "muscle": muscle, "nominal-length": f"{15 * size}mm", "length": f"{13.6 * size}mm",
        "supply": "6bar", "drive": drive, drive: part, "inertia": "0.01", "mass": "1kg", "stop": "25deg",
        **({"regulator-time": "0.1"} if drive == "regulator" else {}),
    }  # fmt: skip
    return [word for name, value in given.items() for word in (f"--{name}", value)]


def read_by_everything(path: Path) -> Rig:
    """Take a file through all that reads one: file, filter, model alone, both kinds of fits."""
    rig = load_rig(path, regulators=True)
    samples, pressure = 20, np.full((20, 2), 0.5 * (rig.supply.pressure + rig.atmosphere.pressure))
    given = pressure if rig.drive == "regulator" else np.full((samples, 2), 5.0)
    stamps = np.arange(1, samples + 1, dtype=np.int64) * round(rig.sample_period * 1e9)
    run = Estimator(rig).run(stamps, pressure, given)
    assert np.isfinite(run.rows["angle"]).all() and np.isfinite(run.rows["covariance"]).all()
    assert np.isfinite(simulate_model(rig, given, pressure[0]).pressure).all()
    free = free_parameters(rig)
    assert free and base_directions(rig)
    return rig


PARTS = [("valve", name) for name in valve_parts()] + [("regulator", name) for name in regulator_parts()]
JOINTS = [(muscle, *part) for muscle, part in zip(itertools.cycle(muscle_parts()), PARTS, strict=False)]
"""Each muscle, valve and regulator once at least."""


@pytest.fixture(scope="module")
def refused() -> list[str]:
    """Complaints about the fits of all joints."""
    return []


@pytest.mark.parametrize(("muscle", "drive", "part"), JOINTS)
def test_the_rig_of_each_part_and_what_a_fit_makes_of_it_are_read(
    muscle: str, drive: str, part: str, tmp_path: Path, refused: list[str]
) -> None:
    assert new_rig.main(["--out", str(tmp_path / "rig.yaml"), *answers(muscle, drive, part)]) == 0
    rig = read_by_everything(tmp_path / "rig.yaml")
    # Values anywhere within the bounds of a fit, and combinations of errors of any size.
    rng = np.random.default_rng(JOINTS.index((muscle, drive, part)))
    free = free_parameters(rig)
    values, steps = {}, {}
    for item in free:
        # The terms of a force map nearly cancel: apart from each other they make no muscle.
        reach = item.prior_std * (0.05 if ".force." in item.name else 3.0)
        value = item.start + reach * float(rng.uniform(-1.0, 1.0))
        values[item.name] = min(max(value, item.low), item.high)
        steps[item.name] = item.prior_std * float(rng.normal())
    fitted = moved(rig, values).replaced(directions={"mode_1": steps}, name=f"{rig.name}_identified")
    out = tmp_path / "identified.yaml"
    try:
        write_rig(fitted, out, ["By a test."])
    except RefusedRig as error:
        assert not out.exists()
        refused.append(str(error))
        return
    assert read_by_everything(out) == fitted


def test_most_fits_are_written(refused: list[str]) -> None:
    assert len(refused) <= len(JOINTS) // 4, refused


def test_only_one_module_writes_rig_files() -> None:
    """All writers go through the one that reads again; the others are a rejected rig's and a comparison's."""
    users = {path for path in (ROOT / "pam_antagonist").rglob("*.py") if "write_unread" in path.read_text("utf-8")}
    assert {path.name for path in users} == {"file.py", "identified.py", "identify_episodes.py"}


@pytest.mark.parametrize(
    ("section", "field", "value", "said"),
    [
        ("friction", "shaft", -0.00166, "friction.shaft"),
        ("gas", "polytropic_volume", 0.0999, "gas.polytropic_volume"),
        ("gas", "polytropic_volume", math.nan, "gas.polytropic_volume"),
        ("valve_1", "inflow_area", 1e-3, "valve_1.inflow_area"),
    ],
)
def test_a_rig_that_its_reader_refuses_is_not_written(
    rig: Rig, tmp_path: Path, section: str, field: str, value: float, said: str
) -> None:
    wrong = rig.unchecked(**{section: getattr(rig, section).unchecked(**{field: value})})
    with pytest.raises(RefusedRig, match=said) as refused:
        write_rig(wrong, tmp_path / "rig.yaml")
    assert isinstance(refused.value, BadInput) and str(tmp_path) not in str(refused.value)
    assert list(tmp_path.iterdir()) == [] and refusal(wrong) == str(refused.value)


def test_a_number_of_numpy_is_written_as_a_number(rig: Rig, tmp_path: Path) -> None:
    tuning = rig.tuning("default").replaced(process=list(rig.tuning("default").process))
    found = rig.replaced(joint=rig.joint.replaced(inertia=np.float64(5e-4)), tunings={"default": tuning})
    write_rig(found, tmp_path / "rig.yaml")
    assert load_rig(tmp_path / "rig.yaml").joint.inertia == 5e-4


def test_sigma_points_of_any_uncertainty_have_positive_numbers(rig: Rig) -> None:
    wide = rig.replaced(
        uncertainty={"friction.shaft": rig.friction.shaft, "valve_1.inflow_area": rig.valve_1.inflow_area},
        directions={"mode_1": {"joint.inertia": 30.0 * rig.joint.inertia, "gas.polytropic_volume": -2.0}},
    )
    assert refusal(wide) == ""
    from pam_antagonist.estimation.estimator import parameter_sets

    sets = parameter_sets(wide, wide.tuning("default"))
    for name in filter(is_positive, NUMBERS):
        assert (sets[:, par.INDEX[name]] > 0.0).all() or rig.value(name) == 0.0, name


def test_small_changes_of_a_value_are_taken_as_they_are() -> None:
    assert varied("friction.shaft", 0.2, -0.15) == 0.2 - 0.15
    assert varied("muscle_1.force.w2", 15.0, -40.0) == -25.0
    changes = np.linspace(-10.0, 10.0, 4001)
    values = np.array([varied("friction.shaft", 1.0, change) for change in changes])
    assert values.min() > 0.0 and (np.diff(values) > 0.0).all()
    slopes = np.diff(values) / np.diff(changes)
    assert np.abs(np.diff(slopes)).max() < 0.05, "a corner"


def test_bounds_of_fits_are_those_of_the_file(rig: Rig) -> None:
    for name in NUMBERS:
        low, high = limits(name)
        value = rig.value(name)
        assert low < high and (low <= value <= high or value == math.inf), name
        for item in free_parameters(rig, free=[name]) if value else ():
            assert limits(item.name)[0] <= item.low < item.high <= limits(item.name)[1]
            reached = [item.value(bound) for bound in item.bounds]
            assert np.clip(reached, item.low, item.high) == pytest.approx(reached, rel=1e-12)


WORDS = (
    "--name elbow --kind pulley --radius 20mm --muscle DMSP-20 --nominal-length 250mm --length 225mm --supply 6bar "
    "--drive valve --voltage 0:10 --inertia 0.03 --mass 1kg --shaft-radius 8mm --stop 40deg --sensor-range 10bar "
    "--sensor-bits 12 --rate 100"
)


def made_of_words(path: Path, words: str) -> Rig:
    assert new_rig.main(["--out", str(path), *WORDS.split(), *words.split()]) == 0
    return load_rig(path)


@pytest.fixture(scope="module")
def elbow(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    return made_of_words(tmp_path_factory.mktemp("rigs") / "elbow.yaml", "--valve MPYE-5-M5")


@pytest.mark.parametrize(("words", "overlap"), [("", 0.5), ("--valve-centre open", 0.0)])
def test_a_valve_of_no_name_has_a_closed_centre_unless_told(words: str, overlap: float, tmp_path: Path) -> None:
    made = made_of_words(tmp_path / "rig.yaml", f"--valve own --valve-flow 50 {words}")
    assert made.valve_1.overlap == overlap and made.valve_1.curve.open_rate == (0.0, 1.0)
    # A closed centre holds a pressure, an open one does not.
    flow, _ = valve_flow(0, 0.5, 3e5, made.supply.pressure, made.parameters())
    assert (flow == 0.0) == (overlap == 0.5)


def test_a_limb_that_was_told_pulls_and_one_that_was_not_widens_the_interval(elbow: Rig, tmp_path: Path) -> None:
    told = made_of_words(
        tmp_path / "rig.yaml", "--valve MPYE-5-M5 --limb-mass 1kg --limb-distance 15cm --limb-hanging=-60deg"
    )
    weight = told.effects["limb_weight"]
    assert weight["torque"] == pytest.approx(9.81 * 0.15, rel=1e-4)
    assert weight["hanging"] == pytest.approx(-math.pi / 3.0, rel=1e-4)
    unknown = "effects.load_torque.constant"
    assert "limb_weight" not in elbow.effects
    # A body of this mass and inertia has its centre at most √(J/m) from the axis.
    assert elbow.uncertainty[unknown] == pytest.approx(9.81 * math.sqrt(0.03 * 1.0), rel=1e-4)
    assert told.uncertainty[unknown] < 0.25 * elbow.uncertainty[unknown]


def test_a_force_map_of_the_paper_still_needs_its_coefficients(elbow: Rig, tmp_path: Path) -> None:
    text = (config_dir() / "rigs" / "shin2022.yaml").read_text("utf-8")
    (tmp_path / "half.yaml").write_text(text.replace("v2: -1.017e-3, ", "", 1), "utf-8")
    with pytest.raises(BadInput, match=r"muscle_1\.force\.v2 is missing: the linear force map needs it"):
        load_rig(tmp_path / "half.yaml")
    assert elbow.muscle_1.force.v2 == 0.0, "another form does not"
