"""The scene file: `schema` says what is in it and writes it, `reading` reads it for models (docs/scenes.md)."""
