"""New sequences and models from models: resampling and editing.

Operations are pure functions from models to a model, which compose::

    from mixseq.operations import cut, loop, repeat, transition

    run = loop(cut(mixseq.load("run.h5"), 0.2, 0.9))
    twice = repeat(run, run.start, run.end, times=2)
    mixseq.save("attack.h5", transition(twice, mixseq.load("slash.h5"), at=1.0, duration=0.3))
"""

from mixseq.operations.filters import exaggerate, smooth
from mixseq.operations.limbs import exaggerate_part, hold
from mixseq.operations.resampling import resample
from mixseq.operations.retiming import Retiming, read_retiming, retime
from mixseq.operations.sculpt import sculpt, swap_key
from mixseq.operations.shape_exchange import key_poses, with_shapes
from mixseq.operations.sketch import drag, sketch
from mixseq.operations.timeline import cut, in_place, loop, repeat, reverse, shift, speed, travel_of
from mixseq.operations.transitions import blend, concatenate, into, transition

__all__ = [
    "Retiming",
    "blend",
    "concatenate",
    "cut",
    "drag",
    "exaggerate",
    "exaggerate_part",
    "hold",
    "in_place",
    "into",
    "key_poses",
    "loop",
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
    "swap_key",
    "transition",
    "travel_of",
    "with_shapes",
]
