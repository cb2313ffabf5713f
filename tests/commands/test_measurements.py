"""check, import and estimate as a user calls them."""

from __future__ import annotations

import errno
import html
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

import flexspline as fs
from flexspline.estimator import offline, registry
from flexspline.models.joint import load_joint
from flexspline.models.joint_parts import LOCKED, Mounting
from flexspline.models.recording import Recording, read_recording, write_recording


@pytest.fixture
def measurement(tmp_path):
    t = np.concatenate([np.arange(4000) * 1e-3, 5 + np.arange(3000) * 1e-3])
    theta = 3.0 * np.sin(2 * np.pi * 0.2 * t)
    current = np.minimum(3.4 * np.sin(2 * np.pi * 0.2 * t), 3.3)
    columns = {"motor_position": 100 * theta, "link_position": theta, "motor_current": current}
    write_recording(Recording("slow", t, columns), tmp_path / "m")
    return tmp_path / "m"


@pytest.fixture(scope="module")
def sweep() -> Recording:
    """A motion of a simulated joint, without its torque sensor and with a gap of a second."""
    moves = ({"time": t, "position": q} for t, q in ((0.3, 0.0), (2.2, 0.9), (5.2, -0.9), (6.5, 0.0)))
    run = fs.simulate("no_load", filters=["RAREKF"], duration=7, trajectory=list(moves), mounting="link")
    there = (run.time < 4.0) | (run.time >= 5.0)
    return replace(run.as_recording().at(there).without("joint_torque"), name="slow")


@pytest.fixture
def sound(sweep, tmp_path):
    write_recording(sweep, tmp_path / "m")
    return tmp_path / "m"


def one_line(err: str) -> str:
    lines = err.splitlines()
    assert len(lines) == 1, err
    return lines[0]


def test_check_says_what_is_there(flexspline, measurement):
    code, out, _ = flexspline("check", measurement)
    assert code == 0
    for text in ("gap of 1.00", "reversals", "joint_torque", "torque_sensor_gain", "current at its limit in"):
        assert text in out


def test_tables_that_no_yaml_file_describes_are_told(flexspline, measurement):
    (measurement / "swept.csv").write_text("time,motor_position\n0,1\n")
    (measurement / ".kept.csv").write_text("")
    code, out, err = flexspline("check", measurement, "--json")
    assert code == 0 and [r["name"] for r in json.loads(out)["recordings"]] == ["slow"]
    assert "swept.csv" in err.splitlines()[0] and "swept.yaml" in err and ".kept" not in err


def test_a_table_beside_another_of_its_name_is_told(flexspline, measurement):
    (measurement / "slow.csv").write_text("time,motor_position\n0,1\n")
    code, out, err = flexspline("check", measurement, "--json")
    assert code == 0 and [r["name"] for r in json.loads(out)["recordings"]] == ["slow"]
    assert err.splitlines()[0].endswith("slow.csv: not read, as slow.parquet was read")


def test_what_a_run_wrote_beside_its_recording_is_no_table_that_was_forgotten(flexspline, tmp_path):
    words = ("--set", "duration=2", "--set", "filters=[model]", "--no-figures", "--no-recording")
    assert flexspline("run", "no_load", *words, "--out", tmp_path)[0] == 0
    folder = tmp_path / "no_load"
    assert len(list(folder.glob("*.parquet"))) > 1
    code, _, err = flexspline("check", folder)
    assert (code, err) == (0, "")


@pytest.mark.parametrize(
    ("inertia", "moment", "named"), [(1.0, 1.0, ""), (100.0, 1.0, "inertia"), (1.0, 0.0, "gravity")]
)
def test_an_external_torque_of_a_wrong_load_is_said_to_be_that(flexspline, sweep, tmp_path, inertia, moment, named):
    """The warning was that there was no external torque, or the angles were said to be in degrees."""
    link = replace_link(sweep.link, inertia, moment)
    write_recording(replace(sweep, link=link), tmp_path / "m")
    code, out, err = flexspline(
        "estimate", tmp_path / "m", "--out", tmp_path / "e", "--filter", "current", "--filter", "RAREKF"
    )
    if code == 2:
        assert "link: " in one_line(err) and f"{named}" in err and "fits the torques, not" in err, err
        return
    text = " ".join(out.split())
    assert code == 0 and ("the external torques are no estimates" in text) == bool(named) and named in err, (out, err)
    found = json.loads((tmp_path / "e" / "metrics.json").read_text())["slow"]
    assert found["no_estimates"] == ({"external_torque": ["RAREKF", "current"]} if named else {})
    assert [named in text for text in found["wrong_load"]] == [True] * bool(named)
    errors = found["external_torque"]
    assert all((errors[name]["rms"] > 1.0) == bool(named) for name in ("RAREKF", "current"))


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_noisy_torque_sensor_is_named(flexspline, tmp_path, rng, share):
    """It was silent: errors of estimates were those of the sensor."""
    moves = [{"time": t, "position": q} for t, q in ((0.3, 0.0), (2.2, 0.9), (5.2, -0.9), (6.5, 0.0))]
    r = fs.simulate("no_load", filters=["model"], duration=7, trajectory=moves, mounting="link").as_recording()
    torque = r["joint_torque"]
    noisy = torque + share * torque.std() * rng.standard_normal(len(torque))
    path = write_recording(replace(r, columns={**r.columns, "joint_torque": noisy}), tmp_path / "m")
    for words in (("check", path), ("estimate", path, "--out", tmp_path / "e", "--filter", "model")):
        code, _, err = flexspline(*words)
        assert code == 0 and ("joint_torque has a noise of" in err) == bool(share), err


def replace_link(link: Mounting, inertia: float, moment: float) -> Mounting:
    """A mounting with other shares of its inertia and gravity moment."""
    return link.model_copy(update={"inertia": inertia * link.inertia, "gravity_moment": moment * link.gravity_moment})


def test_check_says_where_it_does_not_look_for_mistakes(flexspline, sweep, tmp_path):
    columns = sweep.columns | {"link_position": np.zeros(len(sweep.time))}
    bench = Mounting(inertia=LOCKED, gravity_moment=0.0)
    write_recording(replace(sweep, name="bench", columns=columns, link=bench, external="unmeasured"), tmp_path / "m")
    code, out, err = flexspline("check", tmp_path / "m")
    assert code == 0 and not err
    assert "bench: bolted to the bench, not checked for mistakes" in out


@pytest.fixture
def still(tmp_path, rng):
    """A measurement in which nothing moves."""
    n = 3000
    noise = 0.01 * rng.standard_normal(n)
    columns = {"motor_position": np.full(n, 0.1), "link_position": np.full(n, 0.001), "motor_current": noise}
    columns["joint_torque"] = 10 * noise
    write_recording(Recording("still", np.arange(n) * 1e-3, columns, external="unmeasured"), tmp_path / "still")
    return tmp_path / "still"


def test_check_says_what_cannot_show(flexspline, still):
    code, out, _ = flexspline("check", still)
    assert code == 0 and "detectable with these channels" not in out and "no cause is detectable: nothing moves" in out
    for cause in ("cogging", "hysteresis", "stiffness", "gravity_moment", "friction_drift", "mesh_friction"):
        assert cause in out
    assert json.loads(flexspline("check", still, "--json")[1])["can_show"] == []


@pytest.mark.parametrize(
    ("factor", "said"), [(1.0, ""), (1.03, ""), (3.0, "motor_torque is 3 times"), (0.5, "is 0.5 times")]
)
def test_check_says_which_of_current_and_torque_is_read_and_whether_they_agree(
    flexspline, sweep, tmp_path, rng, factor, said
):
    torque = factor * load_joint("test-joint").numbers["Kt"].value * sweep["motor_current"]
    torque = torque + 2e-3 * rng.standard_normal(len(torque))
    both = replace(sweep, name="both", columns={**sweep.columns, "motor_torque": torque})
    write_recording(both, tmp_path / "m")
    code, out, err = flexspline("check", tmp_path / "m")
    assert code == 0 and "`motor_current` takes precedence over `motor_torque`" in out
    assert said in one_line(err) if said else not err


def test_nothing_is_in_motion_where_nothing_moves(flexspline, still, tmp_path):
    code, out, _ = flexspline("estimate", still, "--filter", "current", "--out", tmp_path / "e")
    assert code == 0 and "–" in next(line for line in out.splitlines() if line.startswith("current"))
    score = json.loads((tmp_path / "e" / "metrics.json").read_text())["still"]["joint_torque"]["current"]
    assert score["rms"] > 0 and score["rms_moving"] is None
    code, out, err = flexspline("validate", still, "--out", tmp_path / "v")
    assert code == 0 and "nothing moves" in one_line(err) and "95 % band" not in out and "validation.json" in out
    code, out, _ = flexspline("validate", still, "--json", "--out", tmp_path / "v")
    assert json.loads(out)["residual"] == {}


def test_estimate_scores_and_writes(flexspline, sound, tmp_path):
    code, out, _ = flexspline("estimate", sound, "--out", tmp_path / "e")
    assert code == 0
    assert sorted(p.name for p in (tmp_path / "e").iterdir()) == [".flexspline", "metrics.json", "slow.parquet"]
    report = json.loads((tmp_path / "e" / "metrics.json").read_text())["slow"]
    columns = set(pq.read_table(tmp_path / "e" / "slow.parquet").column_names)
    for name in registry.names():
        assert (f"torque_{name}" in columns) != (name in report["left_out"]), name
        assert name in out
    assert set(report["external_torque"]) == set(registry.names()) - set(report["left_out"])


def test_estimate_by_name(flexspline, sound, tmp_path):
    code, out, _ = flexspline("estimate", sound, "--out", tmp_path / "e", "--filter", "current", "--filter", "EKF")
    assert code == 0 and "RAREKF" not in out
    assert pq.read_table(tmp_path / "e" / "slow.parquet").column_names == [
        "time", "torque_current", "torque_EKF", "external_torque_current", "external_torque_EKF"
    ]  # fmt: skip


def test_estimate_refuses_what_is_wrong_with_the_data(flexspline, sweep, tmp_path):
    """Degrees taken for radians: 400,000 N·m otherwise."""
    columns = sweep.columns | {"motor_position": np.rad2deg(sweep["motor_position"])}
    path = write_recording(replace(sweep, columns=columns), tmp_path / "degrees")
    code, out, err = flexspline("estimate", path, "--out", tmp_path / "e")
    assert code == 2 and out == ""
    line = one_line(err)
    assert "slow: motor_position: degrees, logged as rad, corrected by: × 0.0174533" in line and "--fix" in line
    assert not (tmp_path / "e").exists()
    with pytest.raises(fs.InputError, match="motor_position: degrees, logged as rad"):
        fs.estimate(path)
    assert flexspline("import", path, "--fix", "--out", tmp_path / "mended")[0] == 0
    code, out, _ = flexspline("estimate", tmp_path / "mended", "--filter", "model", "--out", tmp_path / "e")
    assert code == 0


def test_what_mends_a_mistake_is_for_the_joint_that_was_asked_for(flexspline, sweep, tmp_path):
    """Held against the joint of its YAML file a measurement of another one would be mended for that."""
    load_joint("test-joint").write(tmp_path / "mine.yaml")
    columns = sweep.columns | {"motor_position": np.rad2deg(sweep["motor_position"])}
    path = write_recording(replace(sweep, columns=columns), tmp_path / "degrees")
    mine = ("--joint", tmp_path / "mine.yaml")
    for option, reported in ((mine, f" --joint {tmp_path / 'mine.yaml'}"), ((), "")):
        command = f"flexspline import {path} --fix{reported} --out"
        assert f"{command} DIR" in one_line(flexspline("estimate", path, *option, "--out", tmp_path / "e")[2])
        assert f"to correct them: {command} MENDED\n" in flexspline("check", path, *option)[1]
        assert (
            f"to correct them: {command} MENDED\n" in flexspline("validate", path, *option, "--out", tmp_path / "v")[1]
        )
        assert f"{command} MENDED\n" in flexspline("diagnose", path, *option, "--out", tmp_path / "d")[1]
        page = (tmp_path / "d" / "report.html").read_text()
        assert f"{html.escape(command)} MENDED" in page and f"flexspline check {path}{reported}\n" in page


def test_both_encoders_in_degrees_are_no_missing_position(flexspline, sweep, tmp_path):
    angles = ("motor_position", "link_position")
    path = write_recording(
        replace(sweep, columns=sweep.columns | {n: np.rad2deg(sweep[n]) for n in angles}), tmp_path / "degrees"
    )
    code, out, err = flexspline("validate", path, "--json", "--out", tmp_path / "v")
    assert code == 0 and not err
    (reported,) = json.loads(out)["mistakes"]
    assert {reported["column"], *reported["also"]} == set(angles)
    assert reported["severe"] and reported["sure"] and not reported["lost"] and reported["change"] == "× 0.0174533"
    both = "link_position, motor_position: degrees, logged as rad"
    assert f"slow: {both}" in one_line(flexspline("estimate", path, "--out", tmp_path / "e")[2])
    assert both in " ".join(flexspline("diagnose", path, "--out", tmp_path / "d", "--no-report")[1].split())


def test_what_cannot_be_mended_is_not_said_to_be(flexspline, sweep, tmp_path):
    columns = {name: np.full_like(column, column[0]) for name, column in sweep.columns.items()}
    path = write_recording(replace(sweep, columns=columns), tmp_path / "stuck")
    assert "--fix" not in flexspline("check", path)[1]
    code, out, _ = flexspline("validate", path, "--out", tmp_path / "v")
    assert code == 0 and "does not move" in out and "--fix" not in out
    code, _, err = flexspline("estimate", path, "--out", tmp_path / "e")
    assert code == 2 and "does not move; without this column nothing can be estimated" in one_line(err)
    code, out, err = flexspline("import", path, "--fix", "--out", tmp_path / "mended")
    assert code == 2 and not out and one_line(err) and not (tmp_path / "mended").exists()


def test_nothing_is_scored_against_a_sensor_that_is_known_to_be_wrong(flexspline, sound, sweep, tmp_path):
    """A torque sensor that was stuck was the estimators' error, without a word."""
    columns = sweep.columns | {"joint_torque": np.full(len(sweep.time), 0.4)}
    path = write_recording(replace(sweep, columns=columns), tmp_path / "stuck")
    code, out, err = flexspline("estimate", path, "--filter", "model", "--out", tmp_path / "e")
    assert code == 0 and "joint_torque: does not move: nothing is scored against it" in err
    assert "joint_torque" not in json.loads((tmp_path / "e" / "metrics.json").read_text())[sweep.name]
    code, out, err = flexspline("validate", path, "--out", tmp_path / "v")
    assert code == 0 and "stuck" in out and "left out" in out


def test_estimates_that_are_none_are_said_to_be(flexspline, sweep, tmp_path):
    """A sensor that reads a fifth: every estimate is four fifths of the torque off."""
    torque = fs.estimate(sweep)["model"].to_numpy()
    measured = np.nan_to_num(torque)
    for name, factor, expected in (("fifth", 0.2, ["model"]), ("right", 1.0, None)):
        columns = sweep.columns | {"joint_torque": factor * measured}
        path = write_recording(replace(sweep, columns=columns), tmp_path / name)
        code, out, _ = flexspline("estimate", path, "--filter", "model", "--out", tmp_path / f"{name}_e")
        assert code == 0 and ("errors of more than half of that are no estimates" in out) == (expected is not None)
        report = json.loads((tmp_path / f"{name}_e" / "metrics.json").read_text())[sweep.name]
        assert report["no_estimates"].get("joint_torque") == expected


def test_a_reason_is_told_once_for_all_that_it_leaves_out(flexspline, sweep, tmp_path):
    path = write_recording(sweep.without("link_position"), tmp_path / "m")
    code, out, _ = flexspline("estimate", path, "--out", tmp_path / "e")
    left_out = json.loads((tmp_path / "e" / "metrics.json").read_text())[sweep.name]["left_out"]
    assert code == 0 and len(left_out) > len(set(left_out.values()))
    for why in set(left_out.values()):
        assert " ".join(out.split()).count(" ".join(why.split())) == 1, why


def test_time_in_milliseconds_is_not_called_too_short(flexspline, sweep, tmp_path):
    write_recording(replace(sweep, time=1000 * sweep.time), tmp_path / "ms")
    code, _, err = flexspline("estimate", tmp_path / "ms", "--out", tmp_path / "out")
    assert code == 2 and "time: milliseconds, logged as seconds" in one_line(err)


def test_estimate_does_not_overwrite_the_measurement(flexspline, measurement):
    before = (measurement / "slow.parquet").read_bytes()
    code, _, err = flexspline("estimate", measurement, "--out", measurement)
    assert code == 2 and "another folder" in one_line(err)
    assert (measurement / "slow.parquet").read_bytes() == before


def test_an_estimator_that_is_named_must_be_there_and_find_its_channels(flexspline, sound, tmp_path):
    code, _, err = flexspline("estimate", sound, "--out", tmp_path / "e", "--filter", "curent")
    assert code == 2 and "did you mean 'current'" in one_line(err)
    recording = read_recording(sound / "slow.parquet").without("link_position")
    path = write_recording(recording, tmp_path)
    code, _, err = flexspline("estimate", path, "--out", tmp_path / "e", "--filter", "EKF")
    assert code == 2 and "EKF" in one_line(err) and "link_position" in err
    assert not (tmp_path / "e").exists()


def test_nothing_is_told_of_a_folder_that_does_not_come(flexspline, sweep, tmp_path, monkeypatch):
    """Of two recordings the second lacks a channel that a named estimator needs; then, the second cannot be written."""
    write_recording(replace(sweep, name="a_whole"), tmp_path / "m")
    write_recording(replace(sweep, name="b_motor").without("link_position"), tmp_path / "m")
    asked = []

    def estimated(recording, *given, **named):
        asked.append(recording.name)
        return offline_estimate(recording, *given, **named)

    offline_estimate = offline.estimate_recording
    monkeypatch.setattr(offline, "estimate_recording", estimated)
    code, out, err = flexspline(
        "estimate", tmp_path / "m", "--out", tmp_path / "e", "--filter", "current", "--filter", "EKF"
    )
    assert code == 2 and not out and not asked and not (tmp_path / "e").exists()
    assert "b_motor" in one_line(err) and "'EKF': expected the column 'link_position'" in err
    code, out, _ = flexspline("estimate", tmp_path / "m", "--out", tmp_path / "e", "--filter", "current")
    assert code == 0 and asked == ["a_whole", "b_motor"]
    assert [out.index(f"{name}.parquet") for name in asked] == sorted(out.index(f"{name}.parquet") for name in asked)

    def written(estimates, folder):
        if estimates.name == "b_motor":
            raise OSError(errno.ENOSPC, "No space left on device")
        return offline_write(estimates, folder)

    offline_write = offline.write_estimates
    monkeypatch.setattr(offline, "write_estimates", written)
    code, out, err = flexspline("estimate", tmp_path / "m", "--out", tmp_path / "f", "--filter", "current")
    assert code == 2 and not out and "cannot be written" in one_line(err) and not (tmp_path / "f").exists()


def test_bad_input_is_one_line_and_exit_code_2(tmp_path):
    (tmp_path / "a.csv").write_text("time,motor_position,link_position,motor_current\n0,1,2,3\n0,1,2,3\n")
    (tmp_path / "a.yaml").write_text("format: 1\njoint: test-joint\nlink: {inertia: 1, gravity_moment: 0}\n")
    done = subprocess.run([sys.executable, "-m", "flexspline", "check", str(tmp_path)], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and "a.csv" in done.stderr and "row 1" in done.stderr


def test_what_is_too_short_for_any_estimate_is_refused(flexspline, tmp_path):
    t = np.arange(9) * 1e-3
    columns = {"motor_position": 100 * t, "link_position": t, "motor_current": np.sin(t)}
    write_recording(Recording("short", t, columns), tmp_path / "m")
    code, out, err = flexspline("estimate", tmp_path / "m", "--out", tmp_path / "e")
    assert code == 2 and not out and not (tmp_path / "e").exists()
    assert "expected a part without gaps of 10 samples at least" in one_line(err)


def test_samples_too_far_apart_are_told_as_that(flexspline, tmp_path):
    """Not as too short, nor as a gap after every sample."""
    t = np.arange(350) * 0.2
    columns = {"motor_position": 100 * np.sin(t), "link_position": np.sin(t), "motor_current": np.cos(t)}
    write_recording(Recording("sparse", t, columns), tmp_path / "m")
    code, out, err = flexspline("estimate", tmp_path / "m", "--out", tmp_path / "e")
    assert code == 2 and not out and not (tmp_path / "e").exists()
    assert "got samples that are 0.2 s apart" in one_line(err)
    code, out, _ = flexspline("check", tmp_path / "m")
    assert code == 0 and "the log is slower than 10 Hz (5 samples a second)" in " ".join(out.split())
    assert out.count("the recording is split there") == 0


def test_rows_count_alike_in_mistakes_and_in_errors(flexspline, sweep, tmp_path):
    """The same sample is called the same where it is far off and where its cell is empty."""
    write_recording(replace(sweep, name="log"), tmp_path / "m")
    table = pq.read_table(tmp_path / "m" / "log.parquet").to_pandas()
    (tmp_path / "m" / "log.parquet").unlink()
    for value, said in ((table["motor_position"][3000] + 50.0, "row 3000"), (np.nan, "row 3000 (line 3002)")):
        table.loc[3000, "motor_position"] = value
        table.to_csv(tmp_path / "m" / "log.csv", index=False)
        code, out, err = flexspline("check", tmp_path / "m")
        assert said in out + err
    assert code == 2
