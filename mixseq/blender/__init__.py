"""Models that live in Blender: an add-on, and the extension in which it is installed.

The folder `addon` is what Blender runs, and the only one that imports its module ``bpy``. What can be told without
Blender is here: `motion` (vertices in Blender's axes at any time), `frames` (those that are kept), `surfaces` (what a
mesh is made of), and `extension` with `wheels`, which pack it all.
"""
