"""How often stated events are right: `benchmarks.calibrate_rallies` measures the same shares on simulated rallies."""

# Of first hits of which only the flight behind them is seen, and of hits so near the ground that they may be bounces.
UNSEEN_START, LOW_HIT = 0.8, 0.9
# Of events that are wrong although nothing speaks against them.
SLIP = 0.005
# Of events that break the rules: play after a fault, a second bounce, two hits by one player.
DEPARTURE = 3e-4
