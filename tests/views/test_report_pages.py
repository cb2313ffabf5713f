"""Pages of runs, comparisons, sweeps and two diagnoses: self-contained, they begin with the answer, and their charts answer."""

from __future__ import annotations

import csv
import json
import re
import shlex
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from browser import assert_fits, look, sheets

from flexspline.models.errors import InputError
from flexspline.models.files import write_rows
from flexspline.models.joint import load_joint
from flexspline.models.recording import write_recording
from flexspline.models.tables import read_table, write_table
from flexspline.scenarios.evaluation import contact
from flexspline.scenarios.run import Run
from flexspline.scenarios.run_folder import save_run
from flexspline.scenarios.studies.dataset import read_note, read_values
from flexspline.scenarios.studies.statistics import Aggregate, Interval, read_csv, summary_rows, write_csv
from flexspline.scenarios.studies.study import Study
from flexspline.views import contact_views
from flexspline.views.numbers import number
from flexspline.views.pages.contact import contact_html, read_answer, read_curves
from flexspline.views.pages.rendering import TEMPLATES
from flexspline.views.pages.run import line_kinds, runs_html
from flexspline.views.pages.sweep import sweep_html
from flexspline.views.pages.two_diagnoses import read_diagnosis, two_html
from flexspline.views.pages.validation import charts_of, read_validation, validation_html

HEAD = ("What was found", "How sure", "What to do now", "Where this page comes from")


def text_of(page: str) -> str:
    return " ".join(
        unescape(re.sub(r"<style.*?</style>|<script.*?</script>|<[^>]*>", " ", page, flags=re.DOTALL)).split()
    )


@pytest.fixture(scope="module")
def run_page(pushed, bare, tmp_path_factory) -> str:
    return runs_html([(pushed, Path("runs/external push")), (bare, Path("runs/no_load"))])


@pytest.fixture(scope="module")
def sweep_page() -> str:
    folder = Path("sweeps/s")
    worst = [folder / "worst" / "external_push.yaml"]
    return sweep_html(STUDY, found(), {"flexspline": "0.1.0"}, "abcdef0123456789", folder, "levels", worst)


STUDY = Study.model_validate(
    {
        "name": "levels", "description": "Noise <1>.", "seeds": {"count": 9}, "scenarios": ["link_sweep", "no_load"],
        "axes": [{"kind": "scale", "name": "level", "keys": {"sensors.link_encoder.noise": 1e-6}, "values": [1, 8]}],
        "metrics": ["rms", "max"], "filters": ["EKF", "RAREKF"], "reference": "RAREKF",
    }
)  # fmt: skip


def found() -> list[Aggregate]:
    """EKF is better where there is little noise, worse where there is more."""

    def one(mean: float, half: float = 0.01) -> Interval:
        return Interval(mean, mean - half, mean + half, 9)

    rows = []
    for scenario in ("link_sweep", "no_load"):
        for level, error in ((1.0, 0.1), (8.0, 0.4)):
            for name, value in (("EKF", error), ("RAREKF", 0.2)):
                differences = {} if name == "RAREKF" else {m: one(value - 0.2) for m in STUDY.metrics}
                rows.append(
                    Aggregate(
                        scenario, {"level": level}, name, 9, 0, {m: one(value) for m in STUDY.metrics}, differences
                    )
                )
    return rows


def diagnosed(folder: Path, verdict: str, causes: list, calibrated: dict[str, tuple[float, float]], blind=()) -> Path:
    """A folder as `flexspline diagnose` leaves it, without its pages."""
    joint = load_joint("test-joint")
    numbers = {
        name: number.model_copy(
            update={"value": number.value * calibrated[name][0], "std": number.value * calibrated[name][1]}
        )
        if name in calibrated
        else number
        for name, number in joint.numbers.items()
    }
    folder.mkdir(parents=True)
    joint.model_copy(update={"numbers": numbers}).write(folder / "joint.yaml")
    error = {"before": 0.2, "after": 0.02, "noise": 0.019, "unit": "N·m"}
    answer = {
        "verdict": verdict, "causes": causes, "undetermined": list(blind), "residual": {"joint_torque": error},
        "estimation": {"estimators": {"RAREKF": {"before": 0.3, "after": 0.1}}},
    }  # fmt: skip
    (folder / "diagnosis.json").write_text(json.dumps(answer), encoding="utf-8")
    return folder


def named(name: str, component: str, **parameters) -> dict:
    values = {k: {"value": v, "std": s, "unit": u} for k, (v, s, u) in parameters.items()}
    return {"name": name, "component": component, "confidence": 0.98, "parameters": values}


@pytest.fixture(scope="module")
def repair(tmp_path_factory) -> tuple[Path, Path]:
    root = tmp_path_factory.mktemp("repair <1>")
    gap = named("backlash", "transmission", gap=(4e-4, 1e-5, "rad"))
    before = diagnosed(
        root / "before", "discrepancy",
        [gap, named("mesh_friction", "transmission", scale=(1.4, 0.01, "1"))], {"K1": (0.9, 0.01), "Jm": (1.01, 0.01)},
    )  # fmt: skip
    after = diagnosed(
        root / "after", "discrepancy",
        [named("mesh_friction", "transmission", scale=(1.1, 0.01, "1"))], {"K1": (1.02, 0.01), "Jm": (1.0, 0.01)}, ["backlash"],
    )  # fmt: skip
    return before, after


@pytest.fixture(scope="module")
def repair_page(repair) -> str:
    return two_html(*(read_diagnosis(folder) for folder in repair))


def heard(name: str, worse: float, rng: np.random.Generator) -> contact.Detector:
    """A detector of noise, so many times as loud as that of the others."""
    size = np.exp(rng.uniform(np.log(0.3), np.log(8.0), (20, 10)))
    ramp = np.minimum(np.arange(300) / 200.0, 1.0)
    quiet = worse * np.abs(rng.standard_normal((20, 60)))
    return contact.Detector(
        name, quiet, size, np.zeros_like(size), np.maximum.accumulate(size[:, :, None] * ramp, axis=2)
    )


DETECTORS = (("torque sensor", 0.1), ("augmented", 0.2), ("augmented, by the link", 0.5), ("current", 9.0), ("mine", np.inf),
             *((f"other{i}", 1.0) for i in range(9)))  # fmt: skip
"""Names with their noise; one finds no push, one has no threshold."""


@pytest.fixture(scope="module")
def contact_folder(tmp_path_factory) -> Path:
    """What `flexspline contact` writes of drawn detectors."""
    folder, rng = tmp_path_factory.mktemp("contact"), np.random.default_rng(7)
    detectors, curves = [], []
    for tolerance in (0.0, 1.0):
        found = [heard(name, (1 + tolerance) * worse, rng) for name, worse in DETECTORS]
        detectors += contact.ranked(found, 50.0, tolerance)
        curves += [row for d in found for row in contact.curve(d, tolerance)]
    answer = {
        "format": 1, "scenario": "collision", "joint": "my joint", "rate": 50.0, "hours": 0.3, "hours_counted": found[0].hours,
        "runs": 20, "arguments": ["collision", "--tolerance", "0", "--tolerance", "1", "--filter", "augmented", "--set",
        "joint=my joint.yaml", "--plugin", "mine.py"], "detectors": detectors,
    }  # fmt: skip
    (folder / "contact.json").write_text(json.dumps(answer), encoding="utf-8")
    write_rows(folder / "contact.csv", curves)
    return folder


@pytest.fixture(scope="module")
def validation_page(tmp_path_factory) -> str:
    return validation_html(read_validation(validated(tmp_path_factory.mktemp("pages") / "v", 0.5)))


@pytest.fixture(scope="module")
def contact_page(contact_folder) -> str:
    return contact_html(
        read_answer(contact_folder / "contact.json"), read_curves(contact_folder / "contact.csv"), contact_folder
    )


def test_contact_proposes_the_same_for_longer_elsewhere(contact_page, contact_folder, typed):
    (line,) = typed(contact_page)
    words = shlex.split(line)
    answer = json.loads((contact_folder / "contact.json").read_text())
    assert words[: 2 + len(answer["arguments"])] == ["flexspline", "contact", *answer["arguments"]]
    assert words[-4:] == ["--hours", "1.2", "--out", f"{contact_folder}-1.2h"]


def cells_of(page: str) -> list[list[str]]:
    """Cells of every row of every table of a page."""
    rows = re.findall(r"<tr>(.*?)</tr>", page, flags=re.DOTALL)
    return [[text_of(cell) for cell in re.findall(r"<t[hd].*?</t[hd]>", row, flags=re.DOTALL)] for row in rows]


def test_contact_states_what_the_json_has(contact_page, contact_folder):
    """Every detector at every tolerance, with the same numbers as the terminal's table, and why one has none; each line has
    a different look."""
    answer, text = json.loads((contact_folder / "contact.json").read_text()), text_of(contact_page)
    rows = [row for row in cells_of(contact_page) if row[0] != "estimator"]
    assert [row[0] for row in rows] == [d["estimator"] for d in answer["detectors"]]
    assert len(rows) == 2 * len(DETECTORS)
    for cells, d in zip(rows, answer["detectors"], strict=True):
        assert tuple(cells) == next(contact_views.contact_rows([d]))
        for cell, measure, scale in zip(
            cells[2:],
            ("false_alarms_per_hour", "smallest_push", "found_of_large", "delay"),
            (1, 1, 100, 1e3),
            strict=True,
        ):
            for stated, end in zip(re.findall(r"[\d.]+", cell), ("", "_low", "_high"), strict=False):
                assert float(stated) == pytest.approx(
                    scale * d[f"{measure}{end}"], abs=0.51 * 10 ** -len(stated.partition(".")[2])
                )
    assert "torque sensor finds the smallest push" in text and "on my joint within 1 times its tolerances" in text
    assert "Mine: its estimate diverged in 20 of 20 runs without contact; no threshold has so few false alarms." in text
    assert "Current: it finds fewer than 90 % of the pushes of any size." in text
    kinds = re.findall(r'<i class="(\w+)"></i>', contact_page)
    assert len(set(kinds)) == len(kinds) == len(DETECTORS)
    assert all(f".{kind}{{" in contact_page for kind in kinds)


def every(data) -> list[float]:
    """All numbers of JSON, however deep."""
    if isinstance(data, dict):
        data = list(data.values())
    if isinstance(data, (list, tuple)):
        return [number for one in data for number in every(one)]
    return [float(data)] if isinstance(data, (int, float)) and not isinstance(data, bool) else []


def strangers(page: str, data) -> list[str]:
    """Numbers in the cells of a page's tables, of two digits or more, that are the rounding of none in the data: in its unit,
    in percent, in thousandths or in degrees."""
    known = np.abs(every(data))
    scaled = np.concatenate([scale * known for scale in (1.0, 100.0, 1e3, 180 / np.pi)])
    found = []
    for cells in cells_of(page):
        for cell in cells[1:]:
            for text in re.findall(r"\d+\.\d+", "" if "·10" in cell else cell):
                digits = text.partition(".")[2]
                if len(text.replace(".", "").lstrip("0")) >= 2 and not np.any(
                    np.abs(scaled - float(text)) <= 0.5001 * 10.0 ** -len(digits)
                ):
                    found.append(f"{cells[0]}: {text}")
    return found


def test_every_number_of_a_page_is_in_its_json(
    run_page, sweep_page, repair, repair_page, contact_page, contact_folder, tmp_path, pushed, bare
):
    """Of a run, a comparison, an arm, a validation, a sweep, two diagnoses and contact; a changed JSON is noticed."""
    metrics = json.loads(json.dumps({run.name: run.metrics for run in (pushed, bare)}))
    arm = runs_html([(pushed, Path("arm/shoulder")), (bare, Path("arm/elbow"))], Path("arm"))
    path = validated(tmp_path / "v", 0.5)
    answers = [json.loads((folder / "diagnosis.json").read_text()) for folder in repair]
    numbers = [{k: n.value for k, n in load_joint(folder / "joint.yaml").numbers.items()} for folder in repair]
    deviations = [{k: n.std for k, n in load_joint(folder / "joint.yaml").numbers.items()} for folder in repair]
    moved = [  # in standard deviations of both
        (numbers[1][k] - numbers[0][k]) / np.hypot(deviations[0][k], deviations[1][k])
        for k in numbers[0]
        if deviations[0][k] and deviations[1][k]
    ]

    class Of:
        study = STUDY

    rows = list(summary_rows(found(), Of))
    halves = [[v.half for v in one.values.values()] for one in found()]
    pages = {
        "run": (runs_html([(pushed, Path("runs/a"))]), metrics[pushed.name]),
        "comparison": (run_page, metrics),
        "arm": (arm, metrics),
        "validation": (validation_html(read_validation(path)), json.loads((path / "validation.json").read_text())),
        "sweep": (sweep_page, [rows, halves]),
        "two diagnoses": (repair_page, [answers, numbers, deviations, moved]),
        "contact": (contact_page, json.loads((contact_folder / "contact.json").read_text())),
    }
    for kind, (page, data) in pages.items():
        assert strangers(page, data) == [], kind
        assert len(strangers(page, [])) > 0, kind


@pytest.mark.parametrize(
    "spoil",
    [
        lambda a: a.pop("detectors"), lambda a: a.update(detectors=[]), lambda a: a["detectors"][0].update(delay="1"),
        lambda a: a.update(rate=None), lambda a: a["detectors"][1].update(reason=3), lambda a: a.update(format=2),
        lambda a: a.update(arguments=[1]), lambda a: a.update(hours=10**400),
    ],
)  # fmt: skip
def test_an_answer_of_contact_that_is_none_is_one_line(contact_folder, flexspline, tmp_path, spoil):
    answer = json.loads((contact_folder / "contact.json").read_text())
    spoil(answer)
    (tmp_path / "contact.json").write_text(json.dumps(answer))
    (tmp_path / "contact.csv").write_bytes((contact_folder / "contact.csv").read_bytes())
    code, _, err = flexspline("report", tmp_path, "--out", tmp_path / "page.html")
    assert code == 2 and err.count("\n") == 1 and "contact.json: " in err
    (tmp_path / "contact.json").unlink()
    code, _, err = flexspline("report", tmp_path, "--out", tmp_path / "page.html")
    assert code == 2 and err.count("\n") == 1 and "contact.json: cannot read" in err


@pytest.mark.parametrize(
    ("column", "cell"),
    [("runs", "1e999"), ("runs", ""), ("hours", "nan"), ("tolerance", ""), ("smallest_push", "-inf")],
)
def test_curves_with_a_number_that_is_none_are_one_line(contact_folder, flexspline, tmp_path, column, cell):
    rows = list(csv.DictReader((contact_folder / "contact.csv").read_text().splitlines()))
    rows[1][column] = cell
    write_rows(tmp_path / "contact.csv", rows)
    (tmp_path / "contact.json").write_bytes((contact_folder / "contact.json").read_bytes())
    code, _, err = flexspline("report", tmp_path, "--out", tmp_path / "page.html")
    assert code == 2 and err.count("\n") == 1 and f"row 1: {column}: expected a finite number" in err
    assert not (tmp_path / "page.html").exists()


def test_pages_are_self_contained_and_begin_with_the_answer(
    run_page, sweep_page, repair_page, contact_page, validation_page
):
    for page in (run_page, sweep_page, repair_page, contact_page, validation_page):
        assert not re.search(r"\b(?:src|href)=|@import|url\(", page)
        assert '<meta name="generator" content="flexspline">' in page
        text = text_of(page)
        places = [text.index(part) for part in HEAD]
        assert places == sorted(places)
        assert not re.search(r"\b(?:nan|inf|None|undefined)\b", text)
        assert "nan" not in "".join(re.findall(r' d="([^"]*)"', page))
        assert len(page.encode()) < 3e6


@pytest.mark.parametrize("which", ["run_page", "sweep_page", "repair_page", "contact_page", "validation_page"])
def test_commands_to_copy_are_what_the_command_line_takes(which, typed, request):
    assert typed(request.getfixturevalue(which))


def test_a_comparison_names_the_closest_and_what_to_type(run_page, pushed, bare):
    text = text_of(run_page)
    assert "closest to the true joint torque" in text and "Geometric mean over the scenarios" in text
    for run in (pushed, bare):
        assert f"seed {run.scenario.seed}" in text
        for measures in run.metrics["filters"].values():
            assert f"{measures['rms']:.3f}" in text
    assert "flexspline view 'runs/external push'" in text
    assert "know the simulated joint exactly:" in text


def headline(runs: list[tuple[Run, Path]], arm: Path | None = None) -> str:
    return text_of(re.search(r"<h1>(.*?)</h1>", runs_html(runs, arm), flags=re.DOTALL).group(1))


def test_estimators_are_ranked_where_all_are_present(pushed, bare):
    """An estimator of a single joint is not the closest, and does not remove the others."""
    best = min(pushed.estimates, key=lambda name: pushed.metrics["filters"][name]["rms"])
    alone = replace(bare, estimates={best: bare.estimates[best]})
    both = [(pushed, Path("arm/shoulder")), (alone, Path("arm/elbow"))]
    error = pushed.metrics["filters"][best]["rms"]
    assert (
        f"{best} is closest to the true joint torque: {number(error, 2)} N·m RMS, in shoulder: the other joints lack"
        in (headline(both, Path("arm")))
    )
    assert f"in {pushed.name}: the other scenarios lack" in headline(both)
    other = next(name for name in pushed.estimates if name != best)
    apart = replace(pushed, estimates={other: pushed.estimates[other]})
    text = headline([(apart, Path("arm/shoulder")), (alone, Path("arm/elbow"))], Path("arm"))
    assert (
        f"None of these joints has all estimators. Closest to the true joint torque is in shoulder {other} with" in text
    )
    assert f"in elbow {best} with" in text
    nothing = replace(alone.estimates[best], mean=np.full(len(bare.time), np.nan))
    diverged = replace(bare, estimates={**bare.estimates, "never": nothing})
    assert "lack" not in headline([(pushed, Path("a/x")), (diverged, Path("a/y"))])
    assert (
        headline([(replace(alone, estimates={best: nothing}), Path("a"))])
        == "No estimator has an error in any of these scenarios."
    )


def otherwise(tmp_path: Path, **changes) -> Path:
    """The test joint's description with changes."""
    path = tmp_path / "known.yaml"
    load_joint("test-joint").model_copy(update=changes).write(path)
    return path


def knowledge_of(run: Run) -> str:
    return re.search(
        r"The estimators (?:know|do not know) [^.]*\.", text_of(runs_html([(run, Path("runs/a"))]))
    ).group()


def test_estimators_with_another_joint_do_not_know_the_simulated_one(bare, tmp_path):
    """Where only a number differs that is none of `numbers`: kinematic error, a zero, a link's scale, a sensor's noise."""
    joint = load_joint("test-joint")
    encoder = joint.sensors.link_encoder
    moved = encoder.model_copy(update={"zero": encoder.zero.model_copy(update={"value": 2e-3})})
    noisy = encoder.model_copy(update={"noise": 2 * encoder.noise})
    heavier = joint.link_tolerances["inertia"].model_copy(update={"value": 1.1})
    for changes in (
        {"kinematic_error": []}, {"sensors": joint.sensors.model_copy(update={"link_encoder": moved})},
        {"sensors": joint.sensors.model_copy(update={"link_encoder": noisy})},
        {"link_tolerances": {**joint.link_tolerances, "inertia": heavier}},
    ):  # fmt: skip
        known = load_joint(otherwise(tmp_path, **changes))
        assert knowledge_of(replace(bare, known_joint=known)) == (
            "The estimators do not know the simulated joint exactly."
        ), changes
    renamed = load_joint(otherwise(tmp_path, description="the same by another name"))
    assert "know the simulated joint exactly:" in knowledge_of(replace(bare, known_joint=renamed))


def test_a_page_names_the_runs_whose_estimators_know_the_joint(flexspline, tmp_path):
    short = ("--set", "duration=2", "--set", "filters=[model]", "--no-figures", "--out", tmp_path / "runs")
    known = otherwise(tmp_path, kinematic_error=[])
    assert flexspline("run", "no_load", *short)[0] == 0
    assert flexspline("run", "link_sweep", "--set", f"known_joint={known}", *short)[0] == 0
    code, _, err = flexspline("report", tmp_path / "runs", "--out", tmp_path / "page.html")
    assert code == 0, err
    expected = "exactly in no_load (expect larger errors on a real joint), but not in link_sweep."
    assert expected in text_of((tmp_path / "page.html").read_text(encoding="utf-8"))


def test_a_filter_has_one_colour_on_all_pages():
    assert line_kinds(["mine", "RAREKF"])["RAREKF"] == line_kinds(["RAREKF", "EKF"])["RAREKF"]
    assert len(set(line_kinds(["EKF", "AREKF", "RAREKF", "REKF", "a", "b", "c", "d"]).values())) == 8


def test_a_study_says_who_is_better_where(sweep_page):
    text = text_of(sweep_page)
    assert "flexspline run sweeps/s/worst/external_push.yaml" in text
    assert "EKF has the lowest RMS error in 2 of 4 combinations" in text
    assert "EKF against RAREKF: lower in 2, higher in 2, undecided in 0" in text
    assert "flexspline sweep levels --seeds 18 --out sweeps/s" in text
    assert "abcdef012345" in text and "Noise <1>" in text
    assert sweep_page.count('<svg class="chart"') == 2


def test_a_study_shows_distributions_and_the_worst_seeds(tmp_path):
    values = np.arange(1.0, 21.0)
    spread = {"no_load": {"EKF": (values, np.arange(100, 120)), "RAREKF": (values[:3], np.array([7, 8, 8]))}}
    page = sweep_html(STUDY, found(), {}, "abc", tmp_path, values=spread)
    text = text_of(page)
    assert page.count('<svg class="chart"') == 3  # one more than without
    assert "no_load EKF 10.5 19.1 20 119, 118, 117" in text and "no_load RAREKF 2 2.9 3 8, 7" in text


def test_values_of_a_sweep_are_those_of_its_rows(tmp_path):
    folder = Path(__file__).parents[1] / "frozen" / "sweep"
    rows = pa.concat_tables([pq.read_table(p, partitioning=None) for p in sorted(folder.glob("rows/*/*/*.parquet"))])
    study = Study.model_validate(read_note(folder / "study.json")["study"])
    found = read_values(folder, study)
    assert list(found) == ["short"] and set(found["short"]) == set(rows["filter"].to_pylist())
    for name, (values, seeds) in found["short"].items():
        own = [r for r in rows.to_pylist() if r["filter"] == name]
        assert sorted((r["rms"], r["seed"]) for r in own) == list(zip(values.tolist(), seeds.tolist(), strict=True))
    bad = tmp_path / "rows" / "scenario=s" / "cell=0" / "runs-0-0.parquet"
    bad.parent.mkdir(parents=True)
    bad.write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"runs-0-0\.parquet: not a readable Parquet file"):
        read_values(tmp_path, study)
    pq.write_table(rows.set_column(rows.column_names.index("filter"), "filter", pa.array(["a"] * len(rows))), bad)
    with pytest.raises(InputError, match=r"runs-0-0\.parquet: filter: expected one of EKF, got 'a'"):
        read_values(tmp_path, study)


def test_a_summary_is_read_back(tmp_path):
    class Of:
        study = STUDY

    path = tmp_path / "summary.csv"
    write_csv(found(), Of, path)
    assert list(summary_rows(read_csv(path, STUDY), Of)) == list(summary_rows(found(), Of))
    header, first, *_ = path.read_text().splitlines()
    foreign = path.read_text().replace("RAREKF", "a")
    for other in ("a,b\n1,2\n", f"{header}\n{first.split(',')[0]}\n", f"{header}\n{first},1\n"):
        path.write_text(other)
        with pytest.raises(InputError, match="expected the summary of a sweep of levels"):
            read_csv(path, STUDY)
    path.write_text(foreign)
    with pytest.raises(InputError, match="filter: expected one of EKF, RAREKF, got 'a'"):
        read_csv(path, STUDY)


def test_a_summary_with_empty_cells_has_no_mean_there(tmp_path):
    class Of:
        study = STUDY

    path = tmp_path / "summary.csv"
    write_csv(found(), Of, path)
    lines = path.read_text().splitlines()
    empty = {k for k, name in enumerate(lines[0].split(",")) if name.startswith(STUDY.metrics[0])}
    lines[1] = ",".join("" if k in empty else cell for k, cell in enumerate(lines[1].split(",")))
    path.write_text("\n".join(lines))
    (first, *_), (as_it_was, *_) = read_csv(path, STUDY), found()
    assert np.isnan(first.values[STUDY.metrics[0]].mean) and first.filter == as_it_was.filter
    assert "EKF has the lowest RMS error" in text_of(sweep_html(STUDY, read_csv(path, STUDY), {}, "abc", tmp_path))


def test_a_repair_says_what_is_gone_what_stays_and_what_moved(repair_page):
    text = text_of(repair_page)
    assert (
        "Backlash is gone, mesh friction is still present, mesh friction has changed and 1 number of the joint moved."
        in text
    )
    assert "the later measurement could not have shown it" in text
    assert "K1 moved from" in text and "Jm moved from" not in text
    assert "1.400 ± 0.010, then 1.100 ± 0.010" in text


def ripple(order: int, amplitude: float, phase: float) -> dict:
    """Cogging as a diagnosis names it."""
    return named(
        "cogging", "motor", order=(order, 0.0, ""), amplitude=(amplitude, 1e-4, "N·m"), phase=(phase, 0.02, "rad")
    )


def compared(tmp_path: Path, before: list, after: list) -> str:
    """The text of the page of two diagnoses with these causes."""
    folders = [diagnosed(tmp_path / n, "discrepancy", c, {}) for n, c in (("before", before), ("after", after))]
    return text_of(two_html(*(read_diagnosis(folder) for folder in folders)))


def test_causes_of_one_name_differ_by_their_orders(tmp_path):
    text = compared(tmp_path, [ripple(2, 5e-3, 0.1), ripple(6, 2e-3, 0.4)], [ripple(2, 5e-3, 0.1)])
    assert (
        "Cogging of order 6 is gone, cogging of order 2 is still present and no number of the joint moved." in text
    ), text
    assert "cogging of order 6 (motor) was present before" in text and "order 6, then 2" not in text
    assert "cogging of order 2 98 %, cogging of order 6 98 %." in text


def test_unknown_effects_differ_by_what_they_depend_on(tmp_path):
    def unknown(*variables: str) -> dict:
        return {**named("unknown", "transmission"), "depends_on": list(variables)}

    text = compared(tmp_path, [unknown("motor_position")], [unknown("link_position", "direction")])
    assert (
        "Unknown effect of motor position is gone, unknown effect of link position and direction is new and no number"
        in text
    ), text


def test_a_phase_goes_the_short_way_round(tmp_path):
    text = compared(tmp_path, [ripple(2, 5e-3, 3.13)], [ripple(2, 5e-3, -3.14)])
    assert "Cogging of order 2 is still present and no number of the joint moved." in text, text
    text = compared(tmp_path / "more", [ripple(2, 5e-3, 3.13)], [ripple(2, 5e-3, -3.0)])
    assert "cogging of order 2 has changed" in text


def test_an_estimator_without_an_error_has_none_on_the_page(repair, tmp_path):
    """One that diverged with the extended joint, say: JSON has null for what is not finite."""
    other = diagnosed(tmp_path / "other", "consistent", [], {})
    path = other / "diagnosis.json"
    path.write_text(path.read_text(encoding="utf-8").replace('"after": 0.1', '"after": null'), encoding="utf-8")
    assert "RAREKF 0.3 0.1 0.3 –" in text_of(two_html(read_diagnosis(repair[0]), read_diagnosis(other)))


def test_numbers_that_stand_beside_the_others_move_too(tmp_path):
    """The link encoder's zero, kinematic error, direction of gravity, a sensor's delay."""
    folders = []
    for name, zero, amplitude, phase, delay in (("before", 1e-3, 2e-5, 3.13, 0.0), ("after", 2e-3, 3e-5, -3.14, 3e-3)):
        folder = diagnosed(tmp_path / name, "consistent", [], {})
        joint = load_joint("test-joint")
        encoder, first, *others = joint.sensors.link_encoder, *joint.kinematic_error
        order = {
            "amplitude": first.amplitude.model_copy(update={"value": amplitude, "std": 1e-7}),
            "phase": first.phase.model_copy(update={"value": phase, "std": 0.02}),
        }
        moved = encoder.model_copy(update={"zero": encoder.zero.model_copy(update={"value": zero, "std": 1e-6})})
        sensors = joint.sensors.model_copy(update={"link_encoder": moved})
        orders = [first.model_copy(update=order), *others]
        joint.model_copy(update={"sensors": sensors, "kinematic_error": orders}).write(folder / "joint.yaml")
        answer = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
        shift = {"nominal": 0.0, "value": delay, "std": 1e-5, "tolerance": 5e-4, "unit": "s"}
        answer["calibration"] = {"torque_sensor_delay": shift} if delay else {}
        (folder / "diagnosis.json").write_text(json.dumps(answer), encoding="utf-8")
        folders.append(folder)
    text = text_of(two_html(*(read_diagnosis(folder) for folder in folders)))
    assert "3 numbers of the joint moved." in text, text
    first = load_joint("test-joint").kinematic_error[0].order
    for name in ("link encoder zero", f"A{first:g}", "torque sensor delay"):
        assert f"{name} moved from" in text
    assert f"φ{first:g} moved from" not in text


def test_a_damaged_diagnosis_is_refused_in_one_line(flexspline, repair, tmp_path):
    folder = diagnosed(tmp_path / "d", "discrepancy", [ripple(2, 5e-3, 0.1)], {})
    path = folder / "diagnosis.json"
    good = path.read_text(encoding="utf-8")
    for there, instead in (
        ('"value"', '"x"'), ('"std"', '"x"'), ("0.005", '"a"'), ('"unit": "rad"', '"unit": 3'), ('"component"', '"x"'),
        ('"confidence": 0.98', '"confidence": "a"'), ('"verdict": "discrepancy"', '"verdict": 1'),
        ('"undetermined": []', '"undetermined": 1'), ('"joint_torque": {', '"joint_torque": {}, "x": {'),
        ('"causes": [', '"causes": [1, '), ('"name": "cogging"', '"name": ["cogging"]'),
        ('"component"', '"depends_on": 1, "component"'),
    ):  # fmt: skip
        bad = good.replace(there, instead)
        assert bad != good
        path.write_text(bad, encoding="utf-8")
        code, _, err = flexspline("report", folder, repair[0], "--out", tmp_path / "page.html")
        assert code == 2 and err.count("\n") == 1, (bad, err)


def test_two_joints_are_no_repair(repair, tmp_path):
    other = diagnosed(tmp_path / "other", "consistent", [], {})
    described = (other / "joint.yaml").read_text(encoding="utf-8").replace("name: test-joint", "name: another")
    (other / "joint.yaml").write_text(described, encoding="utf-8")
    with pytest.raises(InputError, match="expected a diagnosis of test-joint"):
        two_html(read_diagnosis(repair[0]), read_diagnosis(other))
    (other / "diagnosis.json").write_text("[]")
    with pytest.raises(InputError, match="expected the output of flexspline diagnose"):
        read_diagnosis(other)


def luminance(colour: str) -> float:
    """Relative luminance (WCAG 2) of `#rgb` or `#rrggbb`."""
    digits = colour.lstrip("#")
    digits = "".join(c + c for c in digits) if len(digits) == 3 else digits
    parts = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_contrast_of_text_and_lines_light_and_dark():
    style = (TEMPLATES / "style.css.j2").read_text(encoding="utf-8")
    for part in style.split("@media screen")[:2]:
        colours = dict(re.findall(r"--(\w+):(#\w+)", part))

        def contrast(a: str, b: str, colours=colours) -> float:
            high, low = sorted((luminance(colours[a]), luminance(colours[b])), reverse=True)
            return (high + 0.05) / (low + 0.05)

        for ground in ("ground", "card", "note", "code"):
            assert contrast("ink", ground) >= 7
            assert contrast("soft", ground) >= 4.5, ground
        lines = ("measured", "before", "after", "forward", "backward", *(f"s{i}" for i in range(8)))
        for line in lines:
            assert contrast(line, "card") >= 3, line


ANSWERS = """
const svg = document.querySelector("svg.chart"), box = svg.getBoundingClientRect(), plot = svg.querySelector(".plot");
const at = (share, kind) => svg.dispatchEvent(new PointerEvent(kind, {
  clientX: box.left + share * box.width, clientY: box.top + box.height / 2, pointerType: "mouse", button: 0, bubbles: true}));
at(0.5, "pointermove");
const text = document.querySelector(".tip").textContent;
at(0.4, "pointerdown"); at(0.6, "pointermove"); at(0.6, "pointerup");
const near = plot.getAttribute("viewBox"), made = svg.querySelectorAll(".tick.made").length;
const others = [...document.querySelectorAll("section")][0].querySelectorAll(".plot[viewBox]").length;
svg.dispatchEvent(new MouseEvent("dblclick", {bubbles: true}));
const far = plot.getAttribute("viewBox"), left = svg.querySelectorAll(".tick.made").length;
const entry = document.querySelector(".legend span"), kind = entry.querySelector("i").classList[0];
entry.click();
const off = plot.querySelectorAll(`.${kind}.off`).length;
entry.dispatchEvent(new KeyboardEvent("keydown", {key: "Enter"}));
return {text, near, made, others, far, left, off, on: plot.querySelectorAll(".off").length};
"""


@pytest.mark.slow
def test_charts_tell_zoom_and_hide(run_page, tmp_path):
    found = look(run_page, ANSWERS, 1400, tmp_path)
    assert re.search(r"\d", found["text"]) and "true:" in found["text"] and "RAREKF:" in found["text"]
    left, _, width, _ = map(float, found["near"].split())
    assert 0 < left and 50 < width < 200 and found["made"] >= 4 and found["others"] == 5
    assert found["far"].startswith("0 0 ") and found["left"] == 0
    assert found["off"] == 1 and found["on"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("width", [360, 800, 1400])
@pytest.mark.parametrize("which", ["run_page", "sweep_page", "repair_page", "contact_page", "validation_page"])
def test_nothing_is_wider_than_the_window(which, width, request, tmp_path):
    assert_fits(request.getfixturevalue(which), width, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "which, most", [("run_page", 4), ("sweep_page", 2), ("repair_page", 2), ("contact_page", 2), ("validation_page", 2)]
)
def test_printed_pages_are_full(which, most, request, tmp_path):
    """On paper, charts are in rows and headings stay with their content, so that no sheet is half empty."""
    assert 1 <= sheets(request.getfixturevalue(which), tmp_path) <= most


def test_the_command_writes_a_page_and_only_over_pages(flexspline, pushed, repair, tmp_path):
    folder = save_run(pushed, tmp_path / "runs" / pushed.name)
    page = tmp_path / "page.html"
    for what in (folder, folder.parent):
        code, _, err = flexspline("report", what, "--out", page)
        assert code == 0, err
        assert "closest to the true joint torque" in page.read_text(encoding="utf-8")
    code, _, err = flexspline("report", *repair, "--out", page)
    assert code == 0 and "Backlash is gone" in page.read_text(encoding="utf-8"), err
    (tmp_path / "mine.html").write_text("mine")
    for words in (
        (folder, "--out", tmp_path / "mine.html"), (tmp_path,), (tmp_path / "nowhere",), (repair[0],), (folder,) * 3,
        (folder, "--out", tmp_path / "no" / "page.html"),
    ):  # fmt: skip
        code, _, err = flexspline("report", *words)
        assert code == 2 and err.count("\n") == 1, (words, err)


def test_the_page_of_an_arm_goes_from_its_base_to_its_tip(flexspline, typed, tmp_path):
    short = ("--set", "duration=2", "--set", "arm.0.filters=[model]", "--set", "arm.1.filters=[model]")
    assert flexspline("run", "two_joints", *short, "--no-figures", "--no-recording", "--out", tmp_path)[0] == 0
    code, _, err = flexspline("report", tmp_path / "two_joints", "--out", tmp_path / "page.html")
    assert code == 0, err
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.index("<h2>shoulder") < page.index("<h2>elbow")
    assert len(typed(page)) == 3
    text = text_of(page)
    assert "Run of the arm two_joints , its joints: shoulder (test-joint), elbow (test-joint)" in text
    assert "geometric mean over 2 joints" in text and "alone" not in text
    arm = tmp_path / "two_joints"
    assert f"flexspline view {arm}/shoulder {arm}/elbow" in text and f"flexspline run {arm}/arm.yaml" in text
    words = re.search(r"flexspline diagnose (\S+) ", text).group(1)
    assert flexspline("check", words)[0] == 0, "what it proposes to diagnose is there"
    assert re.search(r"link −?\d+° to −?\d+°, joint torque −?[\d.]+ to −?[\d.]+ N·m", text)


TIME = np.arange(0.0, 8.0, 0.004)


UNSURE = {"column": "motor_current", "description": "mA, logged as A", "severe": True, "sure": False}
MINOR = {"column": "position_command", "description": "does not move", "severe": False, "sure": True}


def validated(folder: Path, off: float = 0.0, mistakes: tuple[str | dict, ...] = (), gap: bool = False) -> Path:
    """A folder as `flexspline validate` leaves it: a current that is `off` by so many amperes while it moves forward."""
    folder.mkdir()
    simulated = np.sin(TIME)
    measured = simulated + off * (np.cos(TIME) > 0)
    if gap:
        simulated = np.where(abs(TIME - 4) < 1, np.nan, simulated)
    columns = {
        "time": TIME, "motor_current": measured, "motor_current_simulated": simulated,
        "motor_current_low": simulated - 0.1, "motor_current_high": simulated + 0.1,
    }  # fmt: skip
    write_table(folder / "sweep <1>.parquet", columns, {"time": "s"} | dict.fromkeys(list(columns)[1:], "A"))
    inside = 1.0 if off < 0.1 else 0.5
    error = {"rms": off / 2**0.5 + 0.01, "mean": off / 2, "noise": 0.01, "unit": "A", "inside": inside, "samples": 2000}
    regions = [
        {
            "by": "direction",
            "from": low,
            "to": low + 1,
            "unit": "",
            "samples": 1000,
            "rms": {"motor_current": rms},
            "beyond": low + 1,
        }
        for low, rms in ((-1.0, 0.01), (0.0, off + 0.01))
    ]
    answer = {
        "joint": "test-joint", "residual": {"motor_current": error}, "regions": regions,
        "beyond": {"link_position": 0.25}, "mistakes": [m if isinstance(m, dict) else {"description": m} for m in mistakes],
        "recordings": ["sweep <1>"],
        "measurement": "bench log", "description": "test-joint",
    }  # fmt: skip
    (folder / "validation.json").write_text(json.dumps(answer), encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    "off, mistakes, sentence, commands",
    [
        (0.0, (), "holds: at least 100 % of every channel lies in its 95 % band.", ["estimate"]),
        (0.08, (), "but motor current is off by more than noise", ["estimate", "diagnose"]),
        (0.5, (), "does not predict motor current: motor current is off by 0.36 A RMS", ["diagnose", "plan"]),
        (
            0.5,
            ("mA, logged as A",),
            "The data have a mistake, so that they show nothing about test-joint: mA",
            ["check"],
        ),
        (0.5, (UNSURE,), "No correction makes the channels fit test-joint: it may be another joint", ["check"]),
        (0.0, (MINOR,), "The description of test-joint holds", ["estimate"]),
    ],
)
def test_a_validation_says_whether_the_description_holds(off, mistakes, sentence, commands, typed, tmp_path):
    page = validation_html(read_validation(validated(tmp_path / "v", off, mistakes)))
    text = text_of(page)
    assert len(typed(page)) == len(commands)
    assert sentence in text and all(f"{head} " in text for head in HEAD)
    assert re.findall(r"flexspline (\w+) 'bench log' --joint test-joint", text) == commands
    assert all(f"{m['column']}: {m['description']}" in text for m in mistakes if isinstance(m, dict))
    assert "25 %" in text and "link angle" in text, "the range of validity"
    assert ("Largest at moving forward" in text) == (off > 0)
    assert "moving forward *" in text and "moving backward *" not in text


def test_bands_of_a_validation_leave_its_gaps(tmp_path):
    (group,) = charts_of(read_validation(validated(tmp_path / "v", 0.02, gap=True)))
    ((_, left),) = group.charts
    band = next(mark for mark in left.marks if mark.kind == "area noise")
    middle, inner = left.inner[0] / 2, left.inner[0]
    places = np.array([float(x) for x in re.findall(r"M([\d.]+) ", band.d)])
    assert not np.any(abs(places - middle) < inner / 8 - 5) and len(places) > 0.6 * inner / 2
    assert left.y[0] == -left.y[1] and 0.02 < left.y[1] < 0.2, "the difference can be seen in it"


def test_a_damaged_validation_is_refused_in_one_line(flexspline, tmp_path):
    folder = validated(tmp_path / "v")
    path, table = folder / "validation.json", folder / "sweep <1>.parquet"
    good = path.read_text(encoding="utf-8")
    for bad in (
        "[]",
        "{",
        "3",
        "[" * 100_000,
        '{"format": 2}',
        good.replace('"rms"', '"x"'),
        good.replace('["sweep <1>"]', '["nowhere"]'),
        good.replace("0.01", '"a"'),
        good.replace("0.01", "Infinity"),
        good.replace("0.01", "1e999"),
        good.replace("0.01", "NaN"),
    ):
        path.write_text(bad, encoding="utf-8")
        code, _, err = flexspline("report", folder, "--out", tmp_path / "page.html")
        assert code == 2 and err.count("\n") == 1, (bad, err)
    path.write_text(good, encoding="utf-8")
    write_table(table, {"time": TIME, "motor_current_simulated": TIME}, {"time": "s", "motor_current_simulated": "A"})
    code, _, err = flexspline("report", folder, "--out", tmp_path / "page.html")
    assert code == 2 and "expected the columns" in err and err.count("\n") == 1


@pytest.mark.parametrize("recordings", ["[]", '["sweep <1>"]'])
def test_a_channel_without_table_is_reported_without_chart(recordings, flexspline, tmp_path):
    path = validated(tmp_path / "v") / "validation.json"
    answer = path.read_text(encoding="utf-8").replace('["sweep <1>"]', recordings)
    path.write_text(answer.replace('"motor_current": {', '"joint_torque": {'), encoding="utf-8")
    assert charts_of(read_validation(path.parent)) == []
    code, _, err = flexspline("report", path.parent, "--out", tmp_path / "page.html")
    assert code == 0 and not err, err
    assert "joint torque" in text_of((tmp_path / "page.html").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"motor_current": np.full(len(TIME), 1e308)}, "column 'motor_current': expected numbers less than 1e+30"),
        ({"time": np.full(len(TIME), 1.0)}, "column 'time': expected times that increase"),
        ({"time": np.append(TIME[:-1], np.inf)}, "column 'time': expected times that increase"),
    ],
)
def test_tables_of_a_validation_that_are_no_measurement_are_refused(change, said, flexspline, tmp_path):
    path = validated(tmp_path / "v") / "sweep <1>.parquet"
    columns = read_table(path)[0] | change
    write_table(path, columns, dict.fromkeys(columns, "1"))
    code, _, err = flexspline("report", path.parent, "--out", tmp_path / "page.html")
    assert code == 2 and said in err and err.count("\n") == 1, err


def test_what_validate_wrote_becomes_a_page(flexspline, pushed, tmp_path):
    """From the run's recording to its page, by its commands."""
    folder = save_run(pushed, tmp_path / pushed.name)
    recording = write_recording(pushed.as_recording(), folder / "bench")
    code, out, err = flexspline("validate", recording, "--out", tmp_path / "validation", "--json")
    assert code == 0, err
    assert json.loads(out)["measurement"] == str(recording) and json.loads(out)["description"] == "test-joint"
    code, _, err = flexspline("report", tmp_path / "validation", "--out", tmp_path / "page.html")
    assert code == 0, err
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "The description of test-joint holds" in page and f"flexspline estimate {recording}" in page


NEAR = """
const svg = document.querySelector("svg.chart"), box = svg.getBoundingClientRect(), plot = svg.querySelector(".plot");
const left = +plot.getAttribute("x"), wide = +plot.getAttribute("width"), scale = box.width / svg.viewBox.baseVal.width;
const at = (share, kind) => svg.dispatchEvent(new PointerEvent(kind, {
  clientX: box.left + (left + share * wide) * scale, clientY: box.top + 50, pointerType: "mouse", button: 0, bubbles: true}));
at(0.6, "pointerdown"); at(0.95, "pointerup");
return [...svg.querySelectorAll(".tick.made.middle")].map(t => t.textContent);
"""


@pytest.mark.slow
def test_places_with_names_keep_them_when_zoomed(sweep_page, tmp_path):
    assert look(sweep_page, NEAR, 1400, tmp_path) == ["8"]
