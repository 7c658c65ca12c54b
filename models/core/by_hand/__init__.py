"""What a person set by hand."""
