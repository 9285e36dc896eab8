"""The ways of finding seed points; ``seeds.find_seeds`` combines them."""
