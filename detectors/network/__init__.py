"""Detection by networks in ONNX files: decoding, second pass on crops, post-processing."""
