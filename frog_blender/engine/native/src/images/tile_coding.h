// Numbers of images that compress well, and back: nothing is lost. See engine/capture/image_coding.py.
#pragma once
#include "frog_native.h"

namespace frog {

// See frog_native.h.
void predict(const FrogPixels &pixels, uint8_t *numbers);
void restore(const uint8_t *numbers, const FrogPixels &pixels);
void predict_details(const FrogPixels &pixels, const FrogPixels &half, uint8_t *numbers);
void restore_details(const uint8_t *numbers, const FrogPixels &half, const FrogPixels &pixels);

}  // namespace frog
