"""What the commands share: common options, consoles and progress displays. The commands are in `pipeline.cli`."""
