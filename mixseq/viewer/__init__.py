"""Views of models and sequences: live and editable in a browser (`live`), or as a page that plays alone (`export`).

`playback`, `session` and `marking` hold what is played and edited; `export_data` has the data of pages.
"""
