"""Commands of a swim that tell apart what a diagnosis of swims leaves open."""
