"""All errors and warnings of mixseq.

Messages name the file, frame, part or face, and a remedy. Errors about values are also `ValueError`, and those about
missing files also `FileNotFoundError`.
"""

from __future__ import annotations


class MixseqError(Exception):
    """Base class of all errors that mixseq raises on purpose."""


class InvalidSequenceError(MixseqError, ValueError):
    """Points, faces or times that do not form a mesh sequence."""


class SegmentationError(MixseqError, ValueError):
    """A segmentation that does not fit the mesh or the request."""


class ReconstructionError(MixseqError):
    """A point of the shape space for which no mesh was found."""


class SettingsError(MixseqError, ValueError):
    """A setting outside its range, or two settings that exclude each other."""


class SizeError(SettingsError):
    """A size in bytes with no room for any motion."""


class FormatError(MixseqError):
    """A file that cannot be read: wrong type, damaged, or too new."""


class MissingFileError(FormatError, FileNotFoundError):
    """A file that does not exist."""


class AmbiguousError(FormatError):
    """A file that holds several candidates, of which one must be chosen."""


class NoMeshError(FormatError):
    """A valid file that has no mesh, or no mesh on its skeleton."""


class OutputError(MixseqError):
    """A file that cannot be written."""


class ClusterError(MixseqError):
    """Workers on other machines that cannot be reached, do not fit, or were lost."""


class GivenUpError(ClusterError):
    """A task that killed several workers."""


class MissingExtraError(MixseqError):
    """An optional package or program that is not installed; the message names the cure."""


class MixseqWarning(UserWarning):
    """Data that a format cannot hold, or that had to be repaired."""
