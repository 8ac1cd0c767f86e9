"""Models in Blender: the add-on, and the extension that installs it.

Only the folder `addon` imports ``bpy`` and has to run in Blender. `motion` converts vertices and polygons to Blender's
axes and units; `extension` builds the archive.
"""
