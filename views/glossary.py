"""The joint's symbols in words, for pages that are read by people who do not have the equations before them."""

from __future__ import annotations

import re

SYMBOLS = {
    "N": "gear ratio, motor turns per output turn",
    "Jm": "rotor inertia",
    "Jw": "wave generator inertia",
    "Jl": "link inertia, as a factor on what the mounting says",
    "Mg": "gravity moment of the link at horizontal, as a factor on what the mounting says",
    "Kt": "torque constant of the motor",
    "bm": "viscous friction of the rotor",
    "bw": "viscous friction of the gear's mesh",
    "bl": "viscous friction at the output",
    "R": "winding resistance",
    "L": "winding inductance",
    "supply_voltage": "supply voltage of the drive",
    "current_limit": "largest current that the drive gives",
    "K1": "stiffness of the flexspline at low torque, up to T1",
    "K2": "stiffness of the flexspline between T1 and T2",
    "K3": "stiffness of the flexspline above T2",
    "T1": "torque at which the stiffness goes from K1 to K2",
    "T2": "torque at which the stiffness goes from K2 to K3",
    "df": "damping of the flexspline",
    "Kw0": "stiffness of the wave generator at zero torque",
    "Cw": "how fast the wave generator stiffens with torque",
    "dw": "damping of the wave generator",
    "Fc": "Coulomb friction of the mesh, motor side",
    "Fs": "static friction of the mesh, motor side",
    "vs": "Stribeck velocity: where static friction has gone over into Coulomb friction",
    "s0": "stiffness of the mesh's friction before it slides (LuGre bristles)",
    "s1": "damping of the mesh's friction before it slides (LuGre bristles)",
    "rated_torque": "rated torque of the gear",
    "back_driven_friction": "share of load-dependent friction while the load drives the motor",
    "gravity_angle": "angle at which the link hangs",
    "link_encoder_zero": "zero of the link encoder against the motor encoder",
    "current_offset": "constant in the current reading",
    "current_delay": "by how much the current reading is late",
    "torque_sensor_gain": "gain of the torque sensor",
    "torque_sensor_offset": "constant in the torque sensor's reading",
    "torque_sensor_delay": "by how much the torque sensor's reading is late",
    "θm": "motor angle",
    "θw": "wave generator angle",
    "θl": "link angle",
    "Δθf": "torsion of the flexspline",
    "Tf": "torque of the flexspline",
    "g(w)": "friction level of the mesh at the motor-side velocity w",
    "EKF": "extended Kalman filter",
    "AREKF": "adaptive robust extended Kalman filter",
    "RAREKF": "redundant adaptive robust extended Kalman filter",
    "RMS": "root mean square",
}
"""What each symbol of joint descriptions, causes and tables means."""

_ORDERS = {
    "A": "amplitude of the gear's kinematic error, {} per turn of the wave generator",
    "φ": "phase of the gear's kinematic error, {} per turn of the wave generator",
}
# Single letters are words of the language too, and names with underscores are read as words.
_IN_TEXT = sorted((s for s in SYMBOLS if len(s) > 1 and "_" not in s and s != "RMS"), key=len, reverse=True)
_PATTERN = re.compile(r"(?<!\w)(?:" + "|".join(re.escape(s) for s in _IN_TEXT) + r"|[Aφ]\d+(?:\.\d+)?′*)(?!\w)")


def meaning(symbol: str) -> str:
    """A symbol in words; empty for one that is not known."""
    order = symbol[1:].rstrip("′")
    if symbol[:1] in _ORDERS and order.replace(".", "").isdigit():
        told = _ORDERS[symbol[0]].format("once" if order == "1" else f"{order} times")
        return f"{told}; a quarter of a period further" if symbol.endswith("′") else told
    return SYMBOLS.get(symbol, "")


def pieces(text: str) -> list[tuple[str, str]]:
    """A text in pieces, each with its meaning where it is a symbol and an empty one where it is not."""
    found, at = [], 0
    for match in _PATTERN.finditer(text):
        found += [(text[at : match.start()], ""), (match.group(), meaning(match.group()))]
        at = match.end()
    return [(piece, told) for piece, told in [*found, (text[at:], "")] if piece]
