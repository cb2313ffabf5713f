"""Recordings for Rerun, written and read back."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from flexspline.models.errors import InputError
from flexspline.sim import plant
from flexspline.sim.shape import shape
from flexspline.views.rerun import write_rerun
from flexspline.views.rerun.diagnosis import send_channel
from flexspline.views.rerun.recording import layout, series_view
from flexspline.views.rerun.recording import recording as opened
from flexspline.views.rerun.scene import DEGREES_PER_TORQUE, send_geoms
from flexspline.views.residuals import Overlay


def series(reader: RrdReader, entity: str) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and values of a series."""
    for chunk in reader.stream().to_chunks():
        if chunk.entity_path == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            times = batch.column("time").to_numpy(zero_copy_only=False).astype("timedelta64[ns]").astype(float) * 1e-9
            values = np.array(batch.column("Scalars:scalars").to_pylist(), dtype=float)[:, 0]
            order = np.argsort(times)
            return times[order], values[order]
    raise AssertionError(f"no {entity}")


@pytest.fixture(scope="module")
def recording(pushed, tmp_path_factory):
    return write_rerun(pushed, tmp_path_factory.mktemp("rerun") / "run.rrd")


def test_a_run_has_its_entities_and_a_layout(recording, pushed):
    reader = RrdReader(recording)
    paths = set(reader.store().schema().entity_paths())
    expected = {
        "/torque/sensor",
        "/torque/truth",
        "/external_torque",
        "/notes",
        "/scene/external",
        "/scene/torque_true",
    }
    expected |= {f"/torsion/{part}" for part in ("total", "flexspline", "wave_generator", "kinematic_error")}
    expected |= {f"/scene/{body}" for body in ("rotor", "wave_generator", "flange", "link")}
    for name in pushed.estimates:
        expected |= {f"/torque/{name}", f"/error/{name}", f"/innovation/{name}/upper"}
    expected |= {"/mode/RAREKF", "/robust_share/RAREKF"}
    assert expected <= paths
    assert len(reader.blueprints()) == 1


def test_series_keep_their_peaks_and_the_pushes(recording, pushed):
    times, values = series(RrdReader(recording), "/torque/RAREKF")
    estimate = pushed.estimate("RAREKF")
    assert values.max() == estimate.max()
    assert values.min() == estimate.min()
    assert len(values) <= 10_000
    assert np.allclose(values, np.interp(times, pushed.time, estimate), atol=1e-6)


def test_parts_of_the_torsion_add_up(recording):
    reader = RrdReader(recording)
    at = np.linspace(0.2, 3.8, 50)
    parts = {
        p: np.interp(at, *series(reader, f"/torsion/{p}")) for p in ("flexspline", "wave_generator", "kinematic_error")
    }
    total = np.interp(at, *series(reader, "/torsion/total"))
    assert np.allclose(sum(parts.values()), total, atol=0.02)  # mrad


def test_the_flexsplines_part_is_the_one_that_carries_the_torque(recording, pushed):
    times, torsion = series(RrdReader(recording), "/torsion/flexspline")
    torque = np.interp(times, pushed.time, pushed.truth("joint_torque"))
    small = np.abs(torque) < 3.5  # N·m, below T1
    assert np.allclose(1e-3 * torsion[small] * 8400, torque[small], atol=0.15)


def test_eighty_seconds_stay_below_twenty_megabytes(recording):
    # Series have a largest number of points, which 4 s nearly reach.
    assert recording.stat().st_size < 8e6


def test_nothing_is_left_where_it_cannot_be_written(pushed, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError):
        write_rerun(pushed, tmp_path / "file" / "run.rrd")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_measured_against_simulated(tmp_path):
    time = np.arange(1000) * 0.01
    measured, left = np.sin(time), np.full(1000, -0.1)
    left[300:400] = np.nan  # a gap
    channels = [
        Overlay("bench", "joint_torque", "N·m", time, measured, left, np.zeros(1000), 0.1, ()),
        Overlay("bench", "link_balance", "N·m", time, None, left, np.zeros(1000), 0.1, ()),
    ]
    path = tmp_path / "measurement.rrd"
    with opened(path, "drop", layout(rrb.Vertical(series_view("joint torque", "recordings")), 10.0)) as stream:
        for channel in channels:
            send_channel(stream, channel)
    reader = RrdReader(path)
    paths = set(reader.store().schema().entity_paths())
    assert {f"/recordings/bench/joint_torque/values/{name}" for name in ("measured", "simulated", "extended")} <= paths
    assert not any("link_balance/values" in place for place in paths)
    _, simulated = series(reader, "/recordings/bench/joint_torque/values/simulated")
    np.testing.assert_allclose(simulated, measured - left, atol=1e-9)
    for channel in ("joint_torque", "link_balance"):
        _, residual = series(reader, f"/recordings/bench/{channel}/residual/simulated")
        assert np.nanmax(np.abs(residual + 0.1)) < 1e-9
        assert np.count_nonzero(np.isnan(residual)) == 100


def test_the_shape_is_the_plants(pushed):
    """Bodies have the positions of the simulated model, which the views do not build."""
    simulated, shown = plant.build(pushed.joint), shape(pushed.joint)
    places = []
    for model in (simulated, shown):
        data = mujoco.MjData(model)
        data.qpos[:3] = 3.0, 2.9, 0.4
        mujoco.mj_kinematics(model, data)
        places.append({model.body(b).name: data.xpos[b].copy() for b in range(model.nbody)})
    assert places[0].keys() == places[1].keys()
    for name, place in places[0].items():
        np.testing.assert_allclose(places[1][name], place, atol=1e-12)


def test_arrows_of_torque_are_as_long_as_the_torque(recording, pushed):
    for chunk in RrdReader(recording).stream().to_chunks():
        if chunk.entity_path == "/scene/torque_true" and not chunk.is_static:
            batch = chunk.to_record_batch()
            strips = np.array([row[0] for row in batch.column("LineStrips3D:strips").to_pylist()])
            times = batch.column("time").to_numpy(zero_copy_only=False).astype("timedelta64[ns]").astype(float) * 1e-9
            break
    assert strips.shape[1:] == (25, 3) and len(strips) == len(times)
    np.testing.assert_allclose(strips[:, 0, 0], 0.0, atol=1e-6)  # they begin above the axis
    lengths = np.linalg.norm(np.diff(strips, axis=1), axis=2).sum(axis=1)
    torque = np.interp(times, pushed.time, pushed.truth("joint_torque"))
    swept = np.maximum(np.radians(DEGREES_PER_TORQUE * np.abs(torque)) - 0.22, 0.0)  # the head is another arrow
    radius = lengths.max() / swept.max()
    np.testing.assert_allclose(lengths, radius * swept, atol=0.01 * lengths.max())


def test_every_kind_of_geom_is_drawn(tmp_path):
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><asset><mesh name="tetra" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset><worldbody>
        <geom name="ground" type="plane" size="1 1 1"/><body name="b"><joint/>
        <geom name="box" type="box" size="1 1 1"/><geom name="ball" type="sphere" size="1"/>
        <geom name="rod" type="capsule" size="0.1 1"/><geom name="tin" type="cylinder" size="0.1 1"/>
        <geom name="egg" type="ellipsoid" size="1 2 3"/><geom name="tetra" type="mesh" mesh="tetra"/>
        </body></worldbody></mujoco>"""
    )
    path = tmp_path / "geoms.rrd"
    with opened(path, "geoms", rr.blueprint.Blueprint(auto_layout=True)) as stream:
        send_geoms(stream, model, 0, "world")
        send_geoms(stream, model, 1, "b")
    paths = set(RrdReader(path).store().schema().entity_paths())
    assert {f"/b/{name}" for name in ("box", "ball", "rod", "tin", "egg", "tetra")} <= paths
    assert not any(path.startswith("/world") for path in paths)


def test_a_push_moves_the_link_the_way_its_arrow_points(pushed):
    """The force at the tip: torque about the joint's axis by the right hand."""
    axis, arm, torque = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -0.4]), 5.0
    direction = np.cross(axis, arm)
    assert np.isclose(np.cross(arm, direction) @ axis * torque, torque * 0.16)
    assert direction[0] > 0  # a link at rest is pushed forward, to +x
