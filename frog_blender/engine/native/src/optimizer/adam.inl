// A step of Adam for the numbers [begin, end) of one parameter.
static void adam(const FrogAdam &p, long long begin, long long end) {
  for (long long i = begin; i < end; ++i) adam_step(p, i);
}
