"""Models in Blender: an add-on, and the extension that installs it.

The folder `addon` runs in Blender, and alone imports its module ``bpy``. The rest works without Blender: `motion` has
vertices and polygons in Blender's axes and units, `extension` packs the archive.
"""
