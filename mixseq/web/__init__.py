"""Playing compressed sequences on the web: the decoder in JavaScript, and what stands on it."""
