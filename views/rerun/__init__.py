"""Recordings for the Rerun viewer: a run with its joint in motion, and measured against simulated channels.

Everything is sent in columns on the timeline `time` [s] as envelopes that keep the peaks; the blueprint is embedded,
so that a recording opens laid out. Entities of a run: `scene/…` the 3D joint, `torque/…`, `error/…`, `innovation/<filter>/…`,
`mode/<filter>`, `robust_share/<filter>`, `torsion/…`, `external_torque`, `position/…`, `position_error`, `current/…`.
"""

from .diagnosis import write_rerun_report
from .overlay import write_rerun_overlay
from .run import RunRecording, write_rerun

__all__ = ["RunRecording", "write_rerun", "write_rerun_overlay", "write_rerun_report"]
