// Adam (Kingma and Ba, algorithm 1) for the numbers [begin, end) of one parameter. Memory is what it waits for: each
// number is read and written once.
static void adam(const FrogAdam &p, long long begin, long long end) {
  for (long long i = begin; i < end; ++i) {
    const float gradient = p.gradients[i];
    const float first = p.first[i] + p.first_share * (gradient - p.first[i]);
    const float second = p.second[i] + p.second_share * (gradient * gradient - p.second[i]);
    p.values[i] -= p.rate * first / (sqrtf(second) * p.second_scale + p.epsilon);
    p.first[i] = first;
    p.second[i] = second;
  }
}
