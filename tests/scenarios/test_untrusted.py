"""An estimate that runs away is marked in a run's tables, page, JSON, and in the folder that is read again."""

from __future__ import annotations

import json

import pytest

RUNAWAY = (
    "known_joint=csg-17-80-ec60",
    "duration=5",
    "filters=[RAREKF, augmented]",
    "trajectory=[{time: 0.5, position: 0}, {time: 3, position: 1}]",
)


@pytest.fixture(scope="module")
def runaway(tmp_path_factory):
    return tmp_path_factory.mktemp("runaway")


def test_everywhere(flexspline, runaway):
    """A joint whose filter believes in another gear ratio: torques beyond the gear."""
    words = [word for change in RUNAWAY for word in ("--set", change)]
    code, text, err = flexspline(
        "run", "link_sweep", *words, "--no-figures", "--no-recording", "--out", runaway / "runs"
    )
    assert code == 0, err
    folder = runaway / "runs" / "link_sweep"
    said = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))["untrusted"]
    assert set(said) == {"RAREKF", "augmented"} and all("times the gear's rated" in why for why in said.values())
    assert "RAREKF†" in text and "RAREKF is not to be trusted" in text
    code, page, err = flexspline("report", folder, "--out", runaway / "page.html")
    assert code == 0, err
    page = (runaway / "page.html").read_text(encoding="utf-8")
    assert page.count("RAREKF †") >= 3 and "is closest to the true joint torque" not in page
    assert said["RAREKF"].partition(" N·m")[0] in page


def test_what_works_is_not_marked(flexspline, runaway):
    code, text, err = flexspline(
        "run", "link_sweep", "--set", "duration=4", "--set", "filters=[RAREKF]", "--no-figures", "--no-recording", "--out",
        runaway / "sound",
    )  # fmt: skip
    assert code == 0 and "†" not in text, err


def test_tuning_is_proposed_for_a_joint_of_one_s_own(flexspline, runaway):
    """Where the mean NIS is not about 1: in the terminal and on the page, with the scenario that holds the joint."""
    code, text, err = flexspline(
        "run", "no_load", "--set", "joint=csg-17-80-ec60", "--set", "duration=2", "--set", "filters=[RAREKF]", "--no-figures",
        "--no-recording", "--out", runaway / "own",
    )  # fmt: skip
    assert code == 0, err
    folder = runaway / "own" / "no_load"
    command = f"flexspline tune {folder}/scenario.yaml --filter RAREKF --out tuned"
    assert command in " ".join(text.split())
    assert flexspline("report", folder, "--out", runaway / "own.html")[0] == 0
    page = (runaway / "own.html").read_text(encoding="utf-8")
    assert command in page and "its mean NIS is" in page
    assert (
        "joint: csg-17-80-ec60" in (folder / "scenario.yaml").read_text(encoding="utf-8")
        or (folder / "joint.yaml").exists()
    )
