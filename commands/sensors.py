"""`flexspline sensors`: channels by name."""

from __future__ import annotations

from ._console import Entry, show
from ._options import AsJson, with_plugins

EXAMPLES = ("flexspline sensors", "flexspline sensors --plugin my_sensor.py --json")


@with_plugins
def command(as_json: AsJson = False) -> None:
    """List the channels of sensors: those of every joint, and those of plugins (`--plugin`)."""
    from ..models import own_sensors
    from ..models.signals import CHANNELS

    entries = {c.name: Entry(c.unit, c.description, "flexspline") for c in CHANNELS.values() if c.sensor}
    for name in own_sensors.names():
        sensor = own_sensors.get(name)
        entries[name] = Entry(sensor.unit, sensor.description, own_sensors.origin(name).name)
    show("channel", entries, as_json)
