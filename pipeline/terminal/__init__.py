"""Parts that commands share on a terminal: common options and progress displays."""
