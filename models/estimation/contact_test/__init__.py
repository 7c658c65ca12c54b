"""Test whether two bodies touched: competing hypotheses about one moment, and answers to umpires' questions."""
