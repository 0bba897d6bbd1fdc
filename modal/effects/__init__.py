"""The catalogue of what a model may lack: a class an effect, a file a family of laws that compete."""
