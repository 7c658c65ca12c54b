"""Files of what a person set by hand."""
