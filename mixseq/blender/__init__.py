"""Models in Blender: an add-on, and the extension that installs it.

The folder `addon` runs in Blender, and alone imports its module ``bpy``. The rest works without Blender: `motion`
(vertices in Blender's axes at any time), `frames` (cached ones), `surfaces` (polygons and their attributes), and
`extension` with `wheels`, which pack it all.
"""
