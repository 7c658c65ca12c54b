"""Physics of a table learned from many shots: paths of single balls, linked at contacts that scatter about their model.

Whole shots from one state amplify every error of a contact model. Here every path between two contacts has a state of
its own, and a contact model with scatter links it to the next: so hundreds of real contacts teach a model that no
single one obeys exactly.
"""
