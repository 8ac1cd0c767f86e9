"""The viewer in a browser: a server of viser with our meshes, controls and charts (extra ``viewer``)."""

from mixseq.viewing.live.viewer import Viewer, ViewSettings, check_viser, viewer

__all__ = ["ViewSettings", "Viewer", "check_viser", "viewer"]
