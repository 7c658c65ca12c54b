"""Physical and observational effects of billiards: one file per effect, in a folder by where it acts.

`billiards_catalogue` collects them. Each file declares the parameters of one effect with their priors (of friction,
restitution, lens distortion and so on). The equations that an effect switches on live with the scene that they belong
to: forces on the cloth in `models.physics.billiards.cloth.forces`, effects of the image in
`models.physics.billiards.simulation.parametrised_shot`.
"""
