"""Blender add-on: deform meshes by mixseq models at every frame and sub-frame, retime and bake them.

`settings` defines the properties of a mesh, `live` moves vertices, `making` creates meshes from models. `importing`,
`timing` and `baking` define the operators; `panel` is the user interface.
"""

from __future__ import annotations

from . import baking, importing, live, panel, settings, timing

_MODULES = (settings, live, importing, timing, baking, panel)


def register() -> None:
    """Register all classes when Blender enables the add-on."""
    for module in _MODULES:
        module.register()


def unregister() -> None:
    """Unregister all classes when Blender disables the add-on."""
    for module in reversed(_MODULES):
        module.unregister()
