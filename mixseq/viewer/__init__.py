"""Views of models and sequences: live and editable in a browser, or as a page that plays on its own."""
