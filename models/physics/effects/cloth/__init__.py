"""Effects that act on a ball while it moves on the cloth or through the air."""
