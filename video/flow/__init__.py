"""Motion of everything that is no ball: optical flow, moving regions, tickers, interpolation networks."""
