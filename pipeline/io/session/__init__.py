"""Files about shots of a player: numbers in scene.json, the tables of a session, and a shot played otherwise."""
