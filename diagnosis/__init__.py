"""Diagnosis of the sim-to-real gap: its places, the missing effect, and how far the gap closes with it.

Models of scenes and effects live in `models`. Input files and written reports are the concern of `pipeline`.
"""
