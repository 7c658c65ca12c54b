"""Training samples: rendered frames on disk, augmentation, distractors and crops."""
