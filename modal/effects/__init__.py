"""The catalogue of what a model may lack, one file an effect."""
