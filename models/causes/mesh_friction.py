"""Mesh friction."""

from .base import Cause, CauseParameter, Requirements


class MeshFriction(Cause):
    name = "mesh_friction"
    component = "transmission"
    description = "Coulomb and static mesh friction (Fc, Fs) are scaled"
    parameters = (CauseParameter("scale", "1", (1e-3, 10.0), ((1.7, 2.5),), neutral=1.0, magnitude=True),)
    scales = ("Fc", "Fs")
    adds = True
    # Friction drifts as the gear warms: by 0.15 % a second it is a few per cent another in every recording.
    inexact = 0.05
    requires = Requirements(sliding=0.5)
