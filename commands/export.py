"""`flexspline export`: recordings for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ._listing import AsJson
from ._measurement import measurement_at
from ._options import MeasurementPath, with_plugins

EXAMPLES = ("flexspline export measurement --out mcap",)


@with_plugins
def command(
    measurement: MeasurementPath,
    out: Annotated[Path, typer.Option(help="folder that the files are written to")],
    as_json: AsJson = False,
) -> None:
    """Write recordings as MCAP, a file each: ROS 2 messages for Foxglove, PlotJuggler and `ros2 bag`.

    `flexspline import` reads them back with a mapping of their topics; docs/importing.md has one.
    """
    from ..diagnosis.data.exporting import write_mcap
    from ..models.output import check_output, made_from, output_folder
    from ._console import console

    data = measurement_at(measurement)
    maker, names = made_from("export", measurement), [f"{recording.name}.mcap" for recording in data.recordings]
    check_output(out, maker, inputs=data.files, writes=names)
    with output_folder(out, maker, inputs=data.files, writes=names) as folder:
        for recording, name in zip(data.recordings, names, strict=True):
            write_mcap(recording, folder / name)
    if as_json:
        from ..models.files import json_text

        print(json_text({r.name: {"file": str(out / name)} for r, name in zip(data.recordings, names, strict=True)}))
        return
    terminal = console()
    for name in names:
        terminal.print(f"{out / name}")
