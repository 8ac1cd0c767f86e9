"""View models and sequences in a browser: in an editable live viewer (`live`), or on a self-contained page (`export`).

`playback` plays scenes; `session` edits models, `posing` by handles; `marking` sets markers. `export_data` encodes the
data of pages.
"""
