"""What a finished diagnosis says, rests on and warns of."""
