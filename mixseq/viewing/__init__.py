"""Looking at models and sequences: in a browser, live and editable, or as a page that plays on its own."""
