"""Deforming meshes from mixseq models: evaluated at every frame and sub-frame, retimed, baked.

What happens in which module: `settings` is what a .blend file keeps of a mesh, `live` moves the vertices, `making`
makes meshes of models, `importing`, `timing` and `baking` are what users do, `panel` where they see it.
"""

from __future__ import annotations

from . import baking, importing, live, panel, settings, timing

_MODULES = (settings, live, importing, timing, baking, panel)


def register() -> None:
    """Tell Blender of everything; Blender calls it when the add-on is switched on."""
    for module in _MODULES:
        module.register()


def unregister() -> None:
    """Take everything back."""
    for module in reversed(_MODULES):
        module.unregister()
