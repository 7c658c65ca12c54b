"""Break shots: racks whose contacts follow each other within a frame or two."""
