"""The one table of synchronization's limits: what is looked at, how much is enough, and when an answer is doubted.

Each stands with its reason, and behind it what needs it: "cards" are the drawn films of cards before a wall that the
tests synchronize, "walk" and "charuco" the real films of four cameras that docs/experiments/calibration.md names.
Numbers that only end a loop or draw a picture stand where they are used.
"""

# --- what is looked at in a film
LEAST_FRAMES = 3  # of a film: less shows no motion
LONGEST_SIDE = 720  # pixels of gray images: enough for features; a phone's film costs no more than a small one (walk)
BACKGROUND_SAMPLES = 30  # frames that suffice to tell the background from what moves (walk: it is hidden in many)
CHANGE = 6.0  # gray levels of 255 beyond the background's: more than encoders and sensors add (charuco's webcams)
REGION_MARGIN = 0.008  # of the width: features on an outline have their centre beside it (cards)
ENERGY_WIDTH = 80  # pixels of the images of which motion energy is the difference
ENERGY_BLUR = 1.5  # pixels of these: smaller details than a moving limb only add noise (walk)
ENERGY_NOISE = 2.0  # gray levels of 255 that a difference must exceed (charuco's webcams)

# --- sound
AUDIO_BAND = (100.0, 6000.0)  # Hz: below it rumbles, above it AAC has nothing
AUDIO_LONGEST = 600.0  # seconds that are read: more tell no more
AUDIO_SEGMENT = 10.0  # seconds that are looked for in the other film: a drifting clock smears longer ones
AUDIO_SEGMENTS = 24  # of a long film: they tell a drift of 1e-5
AUDIO_QUIET = 1e-4  # root mean square of full scale: a muted track
AUDIO_TRAVEL = 0.010  # seconds of standard deviation: sound from a few metres farther away
AUDIO_LEAST_PEAK = 8.0  # standard deviations: a minute of unlike noise reaches 5.5
AUDIO_SURE_PEAK = 20.0  # the same of speech in an echoing room, 10 dB above noise
AUDIO_TOLERANCE = 0.02  # seconds about the line on which segments agree: twice what sound travels
AUDIO_SHOWN = 0.5  # seconds to either side of the peak that the curve keeps
DRIFT_SECONDS = 25.0  # a shorter film tells no drift
TIMECODE_SLACK = 1.0  # seconds: whole frames of free-running clocks

# --- motion energy
ENERGY_LEAST_SHARE = 0.25  # of the shorter film must overlap: films that share less agree by chance
ENERGY_LEAST_SAMPLES = 8
ENERGY_SMOOTHING = 0.5  # frames: a correlation of sampled signals peaks between samples only where they are smooth
ENERGY_TRUST = 0.5  # of its confidence: views that see motion unlike each other agree on a wrong lag (a still film)

# --- moving points and their matches
MOST_FEATURES, MOST_MOVING = 1200, 350  # a frame, and those of them kept that move: more cost time and win nothing
CONTRAST = 0.01  # of SIFT: OpenCV's 0.04 loses small and dark images (cards of 200 pixels)
STILL = 0.15  # pixels a frame: what moves less tells no time
FEATURE_MARGIN = 24  # pixels about the changing region that its features may look at
FLOW_WINDOW = (15, 15)  # pixels
FLOW_BACK = 0.5  # pixels by which a point tracked there and back may miss where it started
BEYOND = 0.6  # frames by which a track may be continued beyond its ends
MATCH_RATIO, MATCH_FARTHEST = 0.8, 0.75  # best to second best descriptor distance, and the best one
KEYFRAME_EVERY = 3  # frames at most: points are tracked so far that no time is missed
FEWEST_KEYFRAMES, MOST_KEYFRAMES = 15, 40  # of a film that has so many frames
NEIGHBORS = 6  # films that each is compared with: more cost time on a dome of cameras
COARSE_KEYFRAMES, COARSE_STEP = 8, 0.5  # and frames between the lags of the coarse search
LEAST_OVERLAP = 0.25  # of the shorter film, where nothing is known
START_FRAMES = 4.0  # to either side of a start that many films agree on
FINE_FRAMES = 2.0  # to either side of the coarse answer
BAND = 4.0  # truncations to either side of an epipolar line in which a match is sought

# --- epipolar residuals
TRUNCATION = 0.005  # of the width, at least one pixel: residuals beyond are false matches
LEAST_SLOPE = 0.25  # pixels a frame by which the residual must change with the lag
MOST_TRIED, MOST_FITTED = 600, 3000  # matches at each lag of the curve, and in the fine search
LEAST_MATCHES = 12  # that a lag needs
DOUBT = 10.0  # a score of few matches is taken as if so many more had failed
REFINED_PEAKS = 3  # maxima of the curve
CORRELATED = 4.0  # matches that count as one: neighbours and successive keyframes err together
BIAS = 0.003  # of the width: residuals that a poor calibration leaves, all over the image (cards, cameras 0.2° off)
MOTION_DRIFT_SECONDS = 15.0  # two clocks' rates are told apart only where matches spread over so much time
SLOWEST = 5e-6  # what two quartz clocks differ in at least: a smaller rate is no rate

# --- one answer from all pairs
FINEST = 0.02  # frames: no pair weighs more than one of this standard deviation
CLOSES = 0.5  # frames by which a pair may miss the answer, and a triangle may fail to close
LOST = 3.0  # frames beyond which a pair that misses costs no more
RIVAL = 0.9  # of the best score: a runner-up as likely (cards whose motion repeats itself)
SURE = 0.75  # of the weight of every film's pairs must agree for a start to be searched near only
RATE_SIGNIFICANT = 3.0  # standard deviations by which a rate must differ from 1
RATE_VISIBLE = 0.02  # frames that a rate must be worth at the end of a film
UNSURE, LEAST_CONFIDENCE = 0.5, 0.1  # below which the user is told, and below which offsets are not to be used
