"""Balls separated from frames and composited onto others: background plate, mattes, deblurring, compositing."""
