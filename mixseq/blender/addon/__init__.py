"""Deforming meshes from mixseq models: evaluated at every frame and sub-frame, retimed, baked.

`settings` holds the settings of a mesh in a .blend file, `live` moves the vertices, `making` makes meshes of models,
`importing`, `timing` and `baking` hold the operators, `panel` the user interface.
"""

from __future__ import annotations

from . import baking, importing, live, panel, settings, timing

_MODULES = (settings, live, importing, timing, baking, panel)


def register() -> None:
    """Register all classes; Blender calls it when the add-on is switched on."""
    for module in _MODULES:
        module.register()


def unregister() -> None:
    """Unregister all classes."""
    for module in reversed(_MODULES):
        module.unregister()
