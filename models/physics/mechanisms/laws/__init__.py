"""One effect of mechanisms per file; each defines `EFFECT`."""
