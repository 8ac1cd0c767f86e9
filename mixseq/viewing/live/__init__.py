"""The viewer in a browser: a server of viser with our meshes, controls and charts (extra ``viewer``)."""

from mixseq.viewing.live.server import check_viser
from mixseq.viewing.live.viewer import Viewer, ViewSettings, viewer

__all__ = ["ViewSettings", "Viewer", "check_viser", "viewer"]
