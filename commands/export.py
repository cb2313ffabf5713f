"""`flexspline export`: recordings for other programs, joints for other simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from ..models.errors import InputError, read_text
from ..models.output import check_output, made_from, output_folder
from ._console import console
from ._measurement import load_measurement, read_measurement_files
from ._options import AsJson, argument, option, with_plugins

EXAMPLES = (
    "flexspline export measurement --out mcap",
    "flexspline export diagnosis --measurement measurement --to mjcf --out joint.xml",
    "flexspline export test-joint --to mjlab --hinge elbow --out elbow.py",
)


@with_plugins
def command(
    source: Annotated[str, argument("a measurement; with `--to` a joint, its file, or the folder of a diagnosis")],
    out: Annotated[Path, option("folder of the recordings; with `--to` the file to write")],
    to: Annotated[str | None, option("simulator: mjcf, urdf, mjlab or isaac")] = None,
    measurement: Annotated[
        Path | None, option("measurement with the motion to fit; by default a standard motion is simulated")
    ] = None,
    into: Annotated[Path | None, option("your MJCF or URDF: change one joint's numbers in a copy")] = None,
    hinge: Annotated[str | None, option("name of the joint in the simulator; by default the joint's name")] = None,
    rigid: Annotated[bool, option("one hinge instead of rotor, spring and link (mjcf)", "--rigid")] = False,
    draws: Annotated[int, option("joints drawn from the uncertainty, written to OUT.draws.json", min=0)] = 0,
    seed: Annotated[int, option("of the draws", min=0)] = 1,
    as_json: AsJson = False,
) -> Any:
    """Write recordings as MCAP, or a joint for another simulator, with the error of its simpler structure.

    Without `--to`: a file per recording, ROS 2 messages for Foxglove, PlotJuggler and `ros2 bag`. `flexspline import` reads them
    back with the mapping of docs/importing.md.

    With `--to`: the numbers are fitted to the joint's behaviour over the motion of the measurement. See docs/export.md.
    """
    if to is None:
        given = {"--into": into, "--hinge": hinge, "--measurement": measurement, "--rigid": rigid, "--draws": draws}
        if alone := [name for name, value in given.items() if value]:
            raise InputError(f"{alone[0]}: expected it with --to, got it alone")
        return _recordings(Path(source), out, as_json)
    from ..models.files import write_json, write_text
    from ..models.joint import load_joint
    from ..models.mjcf import inherited
    from ..views.simulator_files import PLAIN, TARGETS, heading, put_into, users_joint, written

    if to not in TARGETS:
        raise InputError(f"--to: expected one of {', '.join(TARGETS)}, got {to!r}")
    if into is not None and to not in ("mjcf", "urdf"):
        raise InputError(f"--into: expected --to mjcf or urdf, got {to}")
    if out.is_dir():
        raise InputError(f"{out}: expected a file to write to, got a folder")
    path = Path(source)
    described = str(path / "joint.yaml") if path.is_dir() else source
    joint = load_joint(described)
    name, inside, text = hinge or joint.name, (False, True), ""
    if into is not None:
        if out.exists() and out.samefile(into):
            raise InputError(f"--out: expected another file than {into}")
        read_text(into, "a file of a simulator")
        text = into.read_bytes().decode()  # with its line ends
        place = users_joint(text, name, str(into), to)
        inside = inherited(into, name) if to == "mjcf" else inside
    elif not PLAIN.fullmatch(name):
        raise InputError(f"--hinge: expected letters, digits, spaces and _ - . / : +, got {name!r}")
    if measurement is None:
        from ..scenarios.standard_motion import standard_motion

        data, motion = standard_motion(joint), "a simulated standard motion"
    else:
        data, motion = load_measurement(measurement, described)[0], str(measurement)

    from ..diagnosis.collapse import collapse
    from ..sim.plant import link_mass

    structure = (
        "hinge_without_armature" if to == "urdf" else "two_bodies" if to == "mjcf" and not (rigid or into) else "hinge"
    )
    found = collapse(data, joint, structure, draws, seed)
    notes = heading(found, joint.name, motion)
    p = joint.record(data.recordings[0].link)[0]
    mass, lever = link_mass(p)
    if into is None:
        link = {"inertia": float(p["Jl"]), "mass": mass, "lever": lever, "angle": float(p["gravity_angle"])}
        text = written(found, to, name, notes, link)
    else:
        text = put_into(text, place, found, notes, *inside)
    drawn = out.with_name(f"{out.name}.draws.json")
    write_text(out, text)
    if draws:
        write_json(drawn, {"format": 1, "seed": seed, "draws": list(found.draws)})
    if as_json:
        return found.to_json() | {"file": str(out)} | ({"draws": str(drawn)} if draws else {})

    for line in [*notes, str(out), *([str(drawn)] if draws else [])]:
        console().print(line, soft_wrap=True, markup=False, highlight=False)


def _recordings(measurement: Path, out: Path, as_json: bool) -> Any:
    from ..diagnosis.data.exporting import write_mcap

    data = read_measurement_files(measurement)
    maker, names = made_from("export", measurement), [f"{recording.name}.mcap" for recording in data.recordings]
    check_output(out, maker, inputs=data.files, writes=names)
    with output_folder(out, maker, inputs=data.files, writes=names) as folder:
        for recording, name in zip(data.recordings, names, strict=True):
            write_mcap(recording, folder / name)
    if as_json:
        return {r.name: {"file": str(out / name)} for r, name in zip(data.recordings, names, strict=True)}
    terminal = console()
    for name in names:
        terminal.print(f"{out / name}")
