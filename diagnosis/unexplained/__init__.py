"""What remains after the named effects: the force that it amounts to, its place, and its law."""
