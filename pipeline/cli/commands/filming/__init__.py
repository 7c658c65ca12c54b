"""Commands around the filming of shots."""
