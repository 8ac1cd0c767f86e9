"""Use models in Blender by an add-on, which the extension installs.

Only the modules in `addon` import ``bpy`` and have to run in Blender. `motion` converts vertices and polygons to
Blender's axes and units; `extension` builds the archive of the extension.
"""
