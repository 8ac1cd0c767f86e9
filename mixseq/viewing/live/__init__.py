"""The viewer in a browser: a viser server with meshes, controls and charts (extra ``viewer``)."""

from mixseq.viewing.live.marking_viewer import MarkedMeshes, MarkingViewer, marking_viewer
from mixseq.viewing.live.server import check_viser
from mixseq.viewing.live.viewer import Viewer, ViewSettings, viewer

__all__ = [
    "MarkedMeshes",
    "MarkingViewer",
    "ViewSettings",
    "Viewer",
    "check_viser",
    "marking_viewer",
    "viewer",
]
