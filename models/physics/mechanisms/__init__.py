"""Effects of any mechanism: what a simulator of joints, actuators and sensors may lack."""
