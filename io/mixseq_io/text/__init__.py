"""Files of text and arrays about faces and vertices.

`labels`, `derived_labels`, `label_files`: parts; `markers`: markers and contacts; `maps`: correspondences.
"""
