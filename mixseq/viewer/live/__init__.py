"""The viewer in a browser (the extra ``viewer``): `viewer` and `marking` run a viser server behind a `guard`.

`stage` is the scene of the page, `controls` the panels beside it.
"""
