"""Delay of the link encoder."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class EncoderDelay(Cause):
    """The link encoder's reading comes late."""

    name = "encoder_delay"
    component = "sensor"
    description = "the link encoder's reading comes late"
    parameters = (Parameter("seconds", "s", (0.0, 0.09), ((4e-3, 11e-3),), magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["link_delay"] = values["seconds"]
