"""Play compressed sequences on the web: the decoder in JavaScript, and the player built on it."""
