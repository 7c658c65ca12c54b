"""Files about shots of a player: the tables of a session, and a shot played otherwise."""
