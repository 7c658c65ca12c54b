"""Commands that correct runs."""
