"""The rest of a shot from any moment, with how far it can be known."""
