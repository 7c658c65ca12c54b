"""Motion of everything except balls: optical flow, moving regions, tickers, interpolation networks."""
