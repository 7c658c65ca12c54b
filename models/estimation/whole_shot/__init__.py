"""Billiards shots as windows of the multiple-shooting fit: free paths, cushion chains, whole shots, whole tables."""
