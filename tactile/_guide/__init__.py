"""Jobs of gel pads in `loadid guide`: what a pad file, frames and presses of known force are to its ten steps."""
