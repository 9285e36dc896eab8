"""What the command line's subcommands do, and how they say how far they are."""
