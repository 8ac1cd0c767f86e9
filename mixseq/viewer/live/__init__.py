"""Run the live viewer in a browser (extra ``viewer``): `viewer` and `marking` run a viser server behind a `guard`.

`stage` draws the 3D scene of the page; `controls` are the panels beside the scene.
"""
