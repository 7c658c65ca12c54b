"""How often stated events are right. Set by hand: `benchmarks.calibrate_rallies` counts the same on simulated rallies.

docs/explanation/rallies.md says so beside the probabilities that follow from them.
"""

# Of first hits of which only the flight behind them is seen, and of hits so near the ground that they may be bounces.
UNSEEN_START, LOW_HIT = 0.8, 0.9
# Of events that are wrong although nothing speaks against them.
SLIP = 0.005
# Of events that break the rules: play after a fault, a second bounce, two hits by one player.
DEPARTURE = 3e-4
# Share of the logarithm of the evidence of an explanation that counts: it is computed from a model that is never wholly
# true.
EVIDENCE_SHARE = 0.5
