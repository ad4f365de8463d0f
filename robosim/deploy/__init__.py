"""From the simulator to robots: policies as ONNX files, and the controller that runs on a robot."""
