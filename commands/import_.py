"""`flexspline import`: logs in another layout as recordings, and recordings with mistakes corrected."""

from __future__ import annotations

import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..models.errors import InputError, InputWarning, check_each_once
from ..models.output import check_output, output_folder
from ._console import console
from ._measurement import print_mistakes, read_measurement_files
from ._options import AsJson, argument, option, with_plugins

if TYPE_CHECKING:
    from ..diagnosis.data.mistakes import Mistake
    from ..models.joint import Joint
    from ..models.recording import Measurement, Recording

_ENDS = (".parquet", ".yaml", "_arm.xml")  # ends of the names of a recording's files
EXAMPLES = (
    "flexspline import --propose log.csv",
    "flexspline import mapping.yaml log.csv --out measurement",
    "flexspline import ur3e_rtde free.csv loaded.csv --joint my_joint.yaml --out measurement",
    "flexspline import measurement --fix --out mended",
)


@with_plugins
def command(
    what: Annotated[
        list[str],
        argument(
            "a shipped layout (`lara8`, `ur3e`, `ur3e_rtde`) or a mapping file (YAML), and logs (CSV and other text, "
            "Parquet, JSON, npz, mat, HDF5, xlsx, MCAP, ROS bags); or a measurement alone; or, with --propose, a log alone",
            metavar="FORMAT FILE…",
        ),
    ],
    out: Annotated[Path | None, option("folder that the recordings are written to")] = None,
    joint: Annotated[str | None, option("name or path of a joint; by default the layout's")] = None,
    name: Annotated[str | None, option("name of the recording of a single log; by default the log's")] = None,
    propose: Annotated[
        bool, option("print a mapping for a log: its columns, their likely quantities and units", "--propose")
    ] = False,
    fix: Annotated[bool, option("correct the mistakes that `flexspline check` finds", "--fix")] = False,
    force: Annotated[
        bool, option("replace imported recordings with these names; edited YAML files are kept", "--force")
    ] = False,
    as_json: AsJson = False,
) -> Any:
    """Import logs in another layout as recordings: table and YAML. See docs/importing.md.

    `flexspline import --propose LOG > mapping.yaml` makes a draft of such a layout, with marks where values are missing.

    With `--fix`, common mistakes (units, signs, columns exchanged or late, …) are found and corrected. This also works for a
    measurement in this program's format: `flexspline import MEASUREMENT --fix --out DIR`.
    """

    if propose:
        if len(what) != 1 or out is not None:
            raise InputError("--propose: expected one log and no --out, as a mapping is printed")
        from ..diagnosis.data.proposing import proposed

        print(proposed(Path(what[0])), end="")
        return
    if out is None:
        raise InputError("--out: expected the folder that the recordings are written to, got none")
    terminal = console()
    measurement, inputs = _read(what, joint, name)
    written = [f"{recording.name}{suffix}" for recording in measurement.recordings for suffix in (*_ENDS, ".csv")]
    for file in written:
        if not force and (out / file).exists():
            raise InputError(f"{out / file}: expected no such file, --force replaces imported files")
    check_output(out, "import", inputs=inputs, writes=written)
    mistakes: list[Mistake] = []
    described = measurement.load_joint(joint)
    if fix:
        measurement, mistakes, clean = _corrected(measurement, described)
        if not as_json and (mistakes or clean):
            print_mistakes(terminal, mistakes, corrected=True)
    with output_folder(out, "import", inputs=inputs, writes=written) as folder:
        imported = {}
        for recording in measurement.recordings:
            described_by = _relative_joint(recording.joint, measurement.folder, out)
            imported[recording.name] = _write(replace(recording, joint=described_by), folder, out)
    if as_json:
        return {"recordings": imported, "mended": mistakes}
    for one in imported.values():
        if one["description_kept"]:
            terminal.print(f"{Path(one['file']).with_suffix('.yaml')}: kept, as it was edited")
        columns = ", ".join(one["columns"])
        others = " and ".join(Path(file).name for file in one["files"][1:])
        terminal.print(f"{one['file']}, with {others}: {one['samples']} samples, {one['seconds']:.2f} s: {columns}")


def _corrected(given: Measurement, joint: Joint) -> tuple[Measurement, list[Mistake], bool]:
    """Return a measurement with sure mistakes corrected, these mistakes, and whether it has no others."""
    from ..diagnosis.data.mistakes import find_mistakes, fits_no_better, fixed

    found = find_mistakes(given, joint)
    mistakes = [m for m in found if m.sure]
    for m in found:
        if not m.sure:
            warnings.warn(f"{m.where}: not corrected: {m.unmended}", InputWarning, stacklevel=3)
    corrected = fixed(given, joint, mistakes)
    if mistakes and fits_no_better(given, corrected, joint):
        changes = ", ".join(f"{m.where}: {m.change}" if m.where else m.change for m in mistakes)
        raise InputError(
            f"{given.path}: --fix: expected data that fit the joint {joint.name} better, got none by {changes}; "
            "nothing was written"
        )
    if any(m.severe for m in mistakes):  # the correction of one column may show a mistake in another
        for m in find_mistakes(corrected, joint):
            if m.severe:
                text = f"{m.where}: after the correction, {m.description}: check both columns before you use them"
                warnings.warn(text, InputWarning, stacklevel=3)
    return corrected, mistakes, not found


def _write(recording: Recording, folder: Path, out: Path) -> dict[str, Any]:
    """Write a recording into a folder that becomes `out`, but keep a YAML file that was edited; return its description."""
    from ..models.recording import edited, ordered, read_recording, write_recording

    path = write_recording(recording, folder)
    sidecar = (out / path.name).with_suffix(".yaml")
    kept = edited(out / path.name)
    if kept:
        path.with_suffix(".yaml").write_bytes(sidecar.read_bytes())
        try:
            read_recording(path)
        except InputError as error:
            text = str(error).replace(str(folder), str(out))
            raise InputError(f"{sidecar}: expected the edited file to match the new table; {text}") from error
    return {
        "file": str(out / path.name),
        "files": [str(out / f"{path.stem}{end}") for end in _ENDS if (folder / f"{path.stem}{end}").is_file()],
        "samples": len(recording.time),
        "seconds": float(recording.time[-1] - recording.time[0]),
        "columns": list(ordered(recording)),
        "description_kept": kept,
    }


def _read(what: list[str], joint: str | None, name: str | None) -> tuple[Measurement, list[Path]]:
    """Return the recordings, in the folder to which their joint's path is relative, and the files that were read."""
    from ..diagnosis.data.importing import import_recordings, known_layouts, load_layout, unfitting
    from ..models.files import check_name
    from ..models.recording import Measurement

    home = Path()
    if what[0] not in known_layouts() and _is_log(Path(what[0])):
        table = Path(what[0]).suffix in (".csv", ".parquet")
        other = f"; or {Path(what[0]).stem}.yaml next to it, for a recording" if table else ""
        known = ", ".join(known_layouts())
        raise InputError(
            f"{what[0]}: expected FORMAT before it, one of {known} or a mapping file (YAML){other}; got a log"
        )
    if len(what) > 1:
        is_layout = not Path(what[0]).is_dir() and not _is_table(what[0])
    else:
        is_layout = Path(what[0]).suffix in (".yaml", ".yml") and Path(what[0]).is_file() and _is_mapping(Path(what[0]))
    if is_layout or what[0] in known_layouts():
        if len(what) == 1:
            raise InputError(f"format {what[0]!r}: expected one log or more after it, got none")
        if name is not None and len(what) > 2:
            raise InputError(f"--name: expected a single log, got {len(what) - 1}")
        layout = load_layout(what[0])
        stems = [check_name(name or _stem(Path(log)), "--name" if name else log) for log in what[1:]]
        given = zip(what[1:], stems, strict=True)
        found = [recording for log, stem in given for recording in import_recordings(layout, log, stem, joint)]
        if nowhere := unfitting(layout, what[1:]):
            logs = ", ".join(Path(log).name for log in what[1:]) if len(what) <= 4 else f"of {len(what) - 1} logs"
            text = f"{what[0]}: logs: {', '.join(map(repr, nowhere))}: expected to fit a log's name, got {logs}"
            warnings.warn(text, InputWarning, stacklevel=2)
        if joint is None and what[0] not in known_layouts():
            home = Path(what[0]).parent
        inputs = [Path(w) for w in what[1:]]
    else:
        if name is not None:
            raise InputError("--name: expected a log in another layout, got a measurement")
        read = [read_measurement_files(path) for path in what]
        found = [replace(r, joint=joint or _joint_of(r, m)) for m in read for r in m.recordings]
        joints = dict.fromkeys(r.joint for r in found)
        if len(joints) > 1:
            raise InputError(f"expected measurements of one joint, or --joint, got {' and '.join(joints)}")
        inputs = [file for m in read for file in m.files]
    check_each_once([r.name for r in found], "recordings")
    return Measurement(found[0].name, home, tuple(found)), inputs


def _joint_of(recording: Recording, measurement: Measurement) -> str:
    """Return a recording's joint: the name of a shipped joint, or an absolute path."""
    return recording.joint if _is_shipped(recording.joint) else str((measurement.folder / recording.joint).resolve())


def _is_table(path: str) -> bool:
    """Whether a path is a recording: a table, or its YAML file."""
    found = Path(path)
    return found.is_file() and (
        found.suffix == ".parquet"
        or (found.suffix in (".csv", ".yaml", ".yml") and _has_other_half(found) and not _is_mapping(found))
    )


def _is_log(path: Path) -> bool:
    """Whether a path is another program's log, and not a recording, a folder of recordings, or a mapping."""
    if path.is_dir():  # a bag
        return (path / "metadata.yaml").is_file() and not _has_other_half(path / "metadata.yaml")
    if not path.is_file() or path.suffix in (".yaml", ".yml"):
        return False
    if path.suffix in (".csv", ".parquet"):
        return not path.with_suffix(".yaml").is_file()
    try:
        return not _is_mapping(path)
    except InputError:  # no YAML
        return True


def _stem(log: Path) -> str:
    """Return the name of a log's recording: `a` of `a.csv.gz`."""
    return log.with_suffix("").stem if log.suffix in (".gz", ".bz2", ".xz") else log.stem


def _is_mapping(path: Path) -> bool:
    """Whether a YAML file is a mapping, which may have the log's name."""
    from ..models.files import read_yaml

    if path.suffix == ".csv":
        return False
    data = read_yaml(path, "a mapping file, or the YAML file of a recording")
    return isinstance(data, dict) and "columns" in data


def _has_other_half(path: Path) -> bool:
    other = (".yaml",) if path.suffix == ".csv" else (".csv", ".parquet")
    return any(path.with_suffix(suffix).is_file() for suffix in other)


def _relative_joint(joint: str, home: Path, out: Path) -> str:
    """Return a joint for a recording in `out`: the name of a shipped joint, or a path relative to that folder."""
    if _is_shipped(joint):
        return joint
    return Path(os.path.relpath((home / joint).resolve(), out.resolve())).as_posix()


def _is_shipped(joint: str) -> bool:
    from ..models.joint import known_joints

    return joint.replace("_", "-") in known_joints()
