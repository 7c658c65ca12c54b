"""An umpire's questions: did they touch, when, by how much, and how sure is that."""
