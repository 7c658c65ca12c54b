"""How often stated events are right, as `benchmarks.calibrate_rallies` counts it on 24 simulated rallies.

docs/explanation/rallies.md states the counts. The shares of breaks of the rules and of the evidence are not measured.
"""

# Of first hits of which only the flight behind them is seen, and of hits so near the ground that they may be bounces.
UNSEEN_START, LOW_HIT = 0.92, 0.88
# Of events that are wrong although nothing speaks against them.
SLIP = 0.003
# Of events that break the rules: play after a fault, a second bounce, two hits by one player.
DEPARTURE = 3e-4
# Share of the logarithm of the evidence of an explanation that counts: it is computed from a model that is never wholly
# true. Simulated rallies do not tell shares of 0.25 to 1 apart.
EVIDENCE_SHARE = 0.5
