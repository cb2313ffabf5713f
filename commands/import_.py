"""`flexspline import`: a log in another layout as a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    format: Annotated[str, typer.Argument(help="name of a shipped layout (`lara8`), or a mapping file (YAML)")],
    file: Annotated[Path, typer.Argument(help="the log, a CSV file")],
    out: Annotated[Path, typer.Option(help="folder that the recording is written to")],
    joint: Annotated[str | None, typer.Option(help="name of, or path to, a joint; the layout's by default")] = None,
    name: Annotated[str | None, typer.Option(help="name of the recording; the log's by default")] = None,
) -> None:
    """Import a log in another layout as a recording: table and YAML. See docs/importing.md."""
    from ..diagnosis.data.importing import import_recording, load_layout
    from ..models.files import check_name
    from ..models.output import check_output, made_from, output_folder
    from ..models.recording import write_recording
    from ._console import console

    stem = check_name(name or file.stem, "--name")
    maker = made_from("import", file)
    check_output(out, maker, inputs=[file], writes=[f"{stem}.parquet", f"{stem}.yaml"])
    recording = import_recording(load_layout(format), file, name=stem, joint=joint)
    with output_folder(out, maker, inputs=[file]) as folder:
        path = out / write_recording(recording, folder).name
    seconds = recording.time[-1] - recording.time[0]
    columns = ", ".join(["time", *recording.columns])
    console().print(f"{path}: {len(recording.time)} samples, {seconds:.2f} s: {columns}", highlight=False)
