"""Make new models and sequences from models. Operations are pure functions that return a model, so they compose.

`timeline`, `retiming` and `resampling` change times; `transitions` joins motions, at the moments that `shots` finds.
`filters`, `handles` with `pose_solvers`, `limbs`, `sculpt` and `sketch` change poses; `interpolation` blends them.
`script` reads edits from files.
"""

from mixseq.operations.filters import exaggerate, smooth
from mixseq.operations.handles import Handle, pose
from mixseq.operations.limbs import exaggerate_part, hold
from mixseq.operations.resampling import resample
from mixseq.operations.retiming import Retiming, read_retiming, retime
from mixseq.operations.sculpt import sculpt
from mixseq.operations.shots import Moment, find_moments, fit_shots
from mixseq.operations.sketch import drag, sketch
from mixseq.operations.timeline import cut, in_place, loop, repeat, reverse, shift, speed, travel_of
from mixseq.operations.transitions import blend, concatenate, into, transition
from mixseq.signals.shape_exchange import key_poses, with_body

__all__ = [
    "Handle",
    "Moment",
    "Retiming",
    "blend",
    "concatenate",
    "cut",
    "drag",
    "exaggerate",
    "exaggerate_part",
    "find_moments",
    "fit_shots",
    "hold",
    "in_place",
    "into",
    "key_poses",
    "loop",
    "pose",
    "read_retiming",
    "repeat",
    "resample",
    "retime",
    "reverse",
    "sculpt",
    "shift",
    "sketch",
    "smooth",
    "speed",
    "transition",
    "travel_of",
    "with_body",
]
