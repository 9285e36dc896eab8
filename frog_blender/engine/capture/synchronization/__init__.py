"""When each camera's frames were taken: offsets, rates and drift of the films' clocks, to a fraction of a frame."""
