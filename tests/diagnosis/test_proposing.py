"""`flexspline import --propose`: quantities and units of logs as other programs write them, and mappings that read them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import yaml

import flexspline as fs

N, SEED = 1500, 5
T = 0.004 * np.arange(N)
_noise = np.random.default_rng(SEED).normal(size=(4, N))
Q = 0.9 * np.sin(2 * T) + 0.3 * np.sin(5.3 * T)
"""[rad] of the joint that moves; the others move by a tenth of it."""
DQ = np.gradient(Q, T)
I = 1.4 * np.sin(2 * T + 0.4) + 0.05 * _noise[0]
TAU = 9.0 * np.sin(Q) + 0.1 * _noise[1]
DEG = np.rad2deg(Q)
STILL = 0.1 * Q
EPOCH = 1_760_000_000.0

ur = {"timestamp": T + 81234.5}
for k in range(6):
    one = Q if k == 2 else 0.1 * Q + k
    ur |= {
        f"target_q_{k}": one,
        f"target_qd_{k}": DQ,
        f"target_current_{k}": I,
        f"target_moment_{k}": TAU,
        f"actual_q_{k}": one,
    }
    ur |= {
        f"actual_qd_{k}": DQ,
        f"actual_current_{k}": I,
        f"joint_temperatures_{k}": np.full(N, 31.0),
        f"actual_TCP_force_{k}": TAU,
    }
    ur |= {f"actual_current_window_{k}": np.full(N, 0.3), f"joint_control_output_{k}": I, f"actual_TCP_pose_{k}": Q}
ur |= {
    "actual_main_voltage": np.full(N, 48.0),
    "runtime_state": np.full(N, 2),
    "speed_scaling": np.ones(N),
    "actual_robot_current": I + 1,
}
franka = {"time": T}
for k in range(7):
    one = Q if k == 1 else STILL + k / 10
    franka |= {
        f"q[{k}]": one,
        f"q_d[{k}]": one,
        f"dq[{k}]": DQ,
        f"dq_d[{k}]": DQ,
        f"tau_J[{k}]": TAU,
        f"tau_J_d[{k}]": TAU,
    }
    franka |= {f"tau_ext_hat_filtered[{k}]": 0.1 * TAU, f"theta[{k}]": one, f"dtheta[{k}]": DQ, f"dtau_J[{k}]": DQ}
    franka |= {f"O_F_ext_hat_K[{k}]": TAU}
kinova = {"frame_id": np.arange(N), "timestamp_us": np.round(1e6 * T).astype(int)}
for k in range(7):
    angle = np.mod(DEG, 360) if k == 3 else np.mod(0.1 * DEG + 40 * k, 360)
    kinova |= {
        f"actuators[{k}].position": angle,
        f"actuators[{k}].velocity": np.rad2deg(DQ),
        f"actuators[{k}].torque": TAU,
    }
    kinova |= {
        f"actuators[{k}].current_motor": I,
        f"actuators[{k}].voltage": np.full(N, 24.0),
        f"actuators[{k}].temperature_motor": np.full(N, 38.0),
    }

LAYOUTS: dict[str, tuple[dict[str, np.ndarray], dict[str, dict]]] = {
    "ur rtde": (
        ur,
        {
            "time": {"column": "timestamp", "unit": "s", "zero": "first"},
            "link_position": {"column": "actual_q_2", "unit": "rad"},
            "motor_current": {"column": "actual_current_2", "unit": "A"},
            "position_command": {"column": "target_q_2", "unit": "rad"},
            "temperature": {"column": "joint_temperatures_2", "unit": "°C"},
        },
    ),
    "libfranka": (
        franka,
        {
            "time": {"column": "time", "unit": "s"},
            "link_position": {"column": "q[1]", "unit": "rad"},
            "joint_torque": {"column": "tau_J[1]", "unit": "N·m"},
            "position_command": {"column": "q_d[1]", "unit": "rad"},
        },
    ),
    "kinova": (
        kinova,
        {
            "time": {"column": "timestamp_us", "unit": "us"},
            "link_position": {"column": "actuators[3].position", "unit": "deg", "wraps": True},
            "motor_current": {"column": "actuators[3].current_motor", "unit": "A"},
            "joint_torque": {"column": "actuators[3].torque", "unit": "N·m"},
            "temperature": {"column": "actuators[3].temperature_motor", "unit": "°C"},
        },
    ),
    "joint states": (
        {
            "/joint_states/header/stamp": T + EPOCH,
            "/joint_states/position/elbow": Q,
            "/joint_states/position/wrist": STILL,
            "/joint_states/velocity/elbow": DQ,
            "/joint_states/velocity/wrist": DQ,
            "/joint_states/effort/elbow": TAU,
            "/joint_states/effort/wrist": TAU,
        },
        {
            "time": {"column": "/joint_states/header/stamp", "unit": "s", "zero": "first"},
            "link_position": {"column": "/joint_states/position/elbow", "unit": "rad"},
            "joint_torque": {"column": "/joint_states/effort/elbow", "unit": "N·m"},
        },
    ),
    "dynamixel": (
        {
            "time_ms": np.round(1e3 * T).astype(int),
            "present_position": np.round(2048 + Q * 4096 / 2 / np.pi).astype(int),
            "present_velocity": np.round(DQ / 0.024).astype(int),
            "present_current": np.round(I * 1e3 / 2.69).astype(int),
            "goal_position": np.round(2048 + Q * 4096 / 2 / np.pi).astype(int),
            "present_temperature": np.full(N, 41),
            "present_input_voltage": np.full(N, 120),
            "hardware_error_status": np.zeros(N, int),
        },
        {
            "time": {"column": "time_ms", "unit": "ms"},
            "link_position": {"column": "present_position", "unit": "counts", "counts": 4096},
            "motor_current": {"column": "present_current", "unit": "mA", "scale": 2.69},
            "position_command": {"column": "goal_position", "unit": "counts", "counts": 4096},
            "temperature": {"column": "present_temperature", "unit": "°C"},
        },
    ),
    "odrive": (
        {
            "t": T,
            "axis0.encoder.pos_estimate": 50 * Q / 2 / np.pi,
            "axis0.encoder.vel_estimate": 50 * DQ / 2 / np.pi,
            "axis0.motor.current_control.Iq_measured": I,
            "axis0.motor.current_control.Iq_setpoint": I,
            "axis0.controller.input_pos": 50 * Q / 2 / np.pi,
            "vbus_voltage": np.full(N, 24.0),
            "axis0.motor.temp": np.full(N, 35.0),
        },
        {
            "time": {"column": "t", "unit": "s"},
            "motor_position": {"column": "axis0.encoder.pos_estimate", "unit": "rev"},
            "motor_current": {"column": "axis0.motor.current_control.Iq_measured", "unit": "A"},
            "temperature": {"column": "axis0.motor.temp", "unit": "°C"},
        },
    ),
    "two encoders, units in brackets": (
        {
            "Time [ms]": 1e3 * T,
            "Motor angle [deg]": 101 * DEG,
            "Link angle [deg]": DEG,
            "Motor current [mA]": 1e3 * I,
            "Joint torque [Nm]": TAU,
            "Set angle [deg]": DEG,
            "Motor speed [rpm]": 101 * DQ * 60 / 2 / np.pi,
            "Gear temp [°C]": 40 + 0 * T,
        },
        {
            "time": {"column": "Time [ms]", "unit": "ms"},
            "motor_position": {"column": "Motor angle [deg]", "unit": "deg"},
            "link_position": {"column": "Link angle [deg]", "unit": "deg"},
            "motor_current": {"column": "Motor current [mA]", "unit": "mA"},
            "joint_torque": {"column": "Joint torque [Nm]", "unit": "N·m"},
            "position_command": {"column": "Set angle [deg]", "unit": "deg"},
            "temperature": {"column": "Gear temp [°C]", "unit": "°C"},
        },
    ),
    "two encoders, no units": (
        {
            "t": T,
            "q_m": 101 * Q / 2 / np.pi,
            "q_l": Q,
            "i_q": I,
            "tau_s": TAU,
        },
        {
            "time": {"column": "t", "unit": "s"},
            "motor_position": {"column": "q_m", "unit": "rev"},
            "link_position": {"column": "q_l", "unit": "rad"},
            "motor_current": {"column": "i_q", "unit": "A"},
            "joint_torque": {"column": "tau_s", "unit": "N·m"},
        },
    ),
    "motor side in radians": (
        {
            "timeStamp": np.round(1e9 * (EPOCH + T)).astype(np.int64),
            "motorPosition": 100 * Q,
            "outputPosition": Q,
            "motorTorque": 0.01 * TAU,
        },
        {
            "time": {"column": "timeStamp", "unit": "ns", "zero": "first"},
            "motor_position": {"column": "motorPosition", "unit": "rad"},
            "link_position": {"column": "outputPosition", "unit": "rad"},
            "motor_torque": {"column": "motorTorque", "unit": "N·m"},
        },
    ),
    "generic": (
        {"time": T, "pos": Q, "vel": DQ, "cur": I},
        {
            "time": {"column": "time", "unit": "s"},
            "link_position": {"column": "pos", "unit": "rad"},
            "motor_current": {"column": "cur", "unit": "A"},
        },
    ),
    "generic, degrees": (
        {"ms": 1e3 * T, "angle": DEG, "cmd_angle": DEG, "iq": 1e3 * I, "err": I},
        {
            "time": {"column": "ms", "unit": "ms"},
            "link_position": {"column": "angle", "unit": "deg"},
            "motor_current": {"column": "iq", "unit": "mA"},
            "position_command": {"column": "cmd_angle", "unit": "deg"},
        },
    ),
    "german": (
        {"Zeit": T, "Winkel": DEG, "Sollwinkel": DEG, "Strom": I, "Drehmoment": TAU, "Drehzahl": DQ},
        {
            "time": {"column": "Zeit", "unit": "s"},
            "link_position": {"column": "Winkel", "unit": "deg"},
            "motor_current": {"column": "Strom", "unit": "A"},
            "joint_torque": {"column": "Drehmoment", "unit": "N·m"},
            "position_command": {"column": "Sollwinkel", "unit": "deg"},
        },
    ),
    "units as words": (
        {"t_s": T, "q_rad": Q, "qd_rad_s": DQ, "q_target_rad": Q, "i_motor_A": I, "temp_degC": 40 + 0 * T},
        {
            "time": {"column": "t_s", "unit": "s"},
            "link_position": {"column": "q_rad", "unit": "rad"},
            "motor_current": {"column": "i_motor_A", "unit": "A"},
            "position_command": {"column": "q_target_rad", "unit": "rad"},
            "temperature": {"column": "temp_degC", "unit": "°C"},
        },
    ),
    "an effort that is the only torque": (
        {
            "stamp": T + EPOCH,
            "arm_1_joint_position": Q,
            "arm_1_joint_effort": I,
            "arm_2_joint_position": STILL,
            "arm_2_joint_effort": I,
        },
        {
            "time": {"column": "stamp", "unit": "s", "zero": "first"},
            "link_position": {"column": "arm_1_joint_position", "unit": "rad"},
            "joint_torque": {"column": "arm_1_joint_effort", "unit": "N·m"},
        },
    ),
    "a speed and no angle": (
        {"time": T, "omega": DQ, "torque": TAU},
        {
            "time": {"column": "time", "unit": "s"},
            "link_position": {"column": "omega", "unit": "rad/s", "integrate": True},
            "joint_torque": {"column": "torque", "unit": "N·m"},
        },
    ),
    "no time": (
        {"q": Q, "i": I},
        {
            "time": {"rate": 1000},
            "link_position": {"column": "q", "unit": "rad"},
            "motor_current": {"column": "i", "unit": "A"},
        },
    ),
    "a servo's duty": (
        {
            "timestamp": T,
            "position": Q,
            "speed": DQ,
            "load": np.round(300 * TAU / np.abs(TAU).max()),
            "goal_position": Q,
            "torque_enable": np.ones(N, bool),
        },
        {
            "time": {"column": "timestamp", "unit": "s"},
            "link_position": {"column": "position", "unit": "rad"},
            "motor_current": {"column": "load", "unit": "1", "scale": 0.001},
            "position_command": {"column": "goal_position", "unit": "rad"},
        },
    ),
    "dates": (
        {
            "datetime": np.datetime_as_string(
                np.datetime64("2026-03-01T12:00:00") + np.round(1e6 * T).astype("timedelta64[us]")
            ),
            "theta": Q,
            "amps": I,
        },
        {
            "time": {"column": "datetime", "unit": "s"},
            "link_position": {"column": "theta", "unit": "rad"},
            "motor_current": {"column": "amps", "unit": "A"},
        },
    ),
}


def proposal(flexspline, log) -> str:
    code, out, err = flexspline("import", "--propose", log)
    assert code == 0, err
    return out


@pytest.mark.parametrize("kind", LAYOUTS)
def test_quantities_and_units(flexspline, tmp_path, kind):
    """Every column that is proposed is the right one in the right unit; with a joint filled in, the mapping reads the log."""
    columns, expected = LAYOUTS[kind]
    log = tmp_path / "log.csv"
    pd.DataFrame(columns).to_csv(log, index=False)
    text = proposal(flexspline, log)
    found = yaml.safe_load(text)["columns"]
    for one in found.values():
        one.pop("optional", None)
    assert found == expected, text
    (tmp_path / "map.yaml").write_text(text.replace("joint: JOINT", "joint: test-joint"))
    recording = fs.import_log(tmp_path / "map.yaml", log)
    assert set(recording.columns) == set(expected) - {"time"} and len(recording.time) == N
    side, ratio = ("link_position", 1.0) if "link_position" in expected else ("motor_position", 50.0)
    np.testing.assert_allclose(np.ptp(recording[side]) / ratio, np.ptp(Q), rtol=0.01)


def test_what_is_to_be_filled_in_is_marked(flexspline, tmp_path):
    pd.DataFrame({"a": _noise[0], "b": _noise[1]}).to_csv(tmp_path / "log.csv", index=False)
    text = proposal(flexspline, tmp_path / "log.csv")
    assert text.count("FILL IN") >= 5 and "COLUMN" in text and "# Not used: a, b" in text
    (tmp_path / "map.yaml").write_text(text)
    code, _, err = flexspline("import", tmp_path / "map.yaml", tmp_path / "log.csv", "--out", tmp_path / "out")
    assert code == 2 and err.count("\n") == 1 and "COLUMN" in err
    for words in (
        ("--propose",),
        ("--propose", tmp_path / "none.csv"),
        ("--propose", tmp_path / "log.csv", "--out", tmp_path / "o"),
    ):
        code, _, err = flexspline("import", *words)
        assert code == 2 and "Traceback" not in err
    assert flexspline("import", tmp_path / "map.yaml", tmp_path / "log.csv")[0] == 2


@pytest.mark.parametrize("suffix", ["npz", "parquet", "json", "xlsx", "mat", "h5"])
def test_every_format(flexspline, tmp_path, suffix):
    import scipy.io

    path, table = tmp_path / f"log.{suffix}", {"time": T, "q": Q, "i": I}
    write = {
        "npz": lambda: np.savez(path, **table),
        "mat": lambda: scipy.io.savemat(path, table),
        "json": lambda: pd.DataFrame(table).to_json(path, orient="records"),
        "xlsx": lambda: pd.DataFrame(table).to_excel(path, index=False),
        "parquet": lambda: pd.DataFrame(table).to_parquet(path),
        "h5": lambda: _hdf5(path, table),
    }
    write[suffix]()
    found = yaml.safe_load(proposal(flexspline, path))["columns"]
    assert {target: one["column"] for target, one in found.items()} == {
        "time": "time",
        "link_position": "q",
        "motor_current": "i",
    }


def _hdf5(path, table) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in table.items():
            file.create_dataset(name, data=values)


def test_lerobot_and_others(flexspline, tmp_path):
    """Lists a row and episodes, as LeRobot has them."""
    episodes = np.repeat(np.arange(3), N // 3)
    state = np.stack([0.1 * DEG, DEG, STILL], 1).tolist()
    table = {
        "action": state,
        "observation.state": state,
        "observation.current": np.stack([I, I, I], 1).tolist(),
        "timestamp": np.tile(np.arange(N // 3) / 30, 3).astype(np.float32),
        "frame_index": np.tile(np.arange(N // 3), 3),
        "episode_index": episodes,
        "index": np.arange(N),
        "task_index": np.zeros(N, int),
        "next.done": np.zeros(N, bool),
    }
    pd.DataFrame(table).to_parquet(tmp_path / "file-000.parquet")
    text = proposal(flexspline, tmp_path / "file-000.parquet")
    found = yaml.safe_load(text)
    assert found["episodes"] == "episode_index", text
    columns = {target: (one["column"], one["unit"]) for target, one in found["columns"].items()}
    assert columns == {
        "time": ("timestamp", "s"), "link_position": ("observation.state/1", "deg"),
        "motor_current": ("observation.current/1", "A"), "position_command": ("action/1", "deg"),
    }, text  # fmt: skip
