"""What moves and how: values that flow through the pipeline, and the physics fitted to them."""
