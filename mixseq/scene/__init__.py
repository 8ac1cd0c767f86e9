"""A scene: meshes that move, with their colours, cameras and places; pictures, films, pages and the viewer draw it.

`items` are what is shown and `scene_times` says when; `colouring` is what colours show of a mesh and `colours` of all
of them, by what `vertex_measures` find, from `palettes`; `camera` is from where, `arrangement` where the meshes stand.
"""

from mixseq.scene.camera import Camera, View
from mixseq.scene.colouring import Colouring, colourings_of
from mixseq.scene.colours import SceneColours
from mixseq.scene.items import Scene, SceneItem

__all__ = ["Camera", "Colouring", "Scene", "SceneColours", "SceneItem", "View", "colourings_of"]
