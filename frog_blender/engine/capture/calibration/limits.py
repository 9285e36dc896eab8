"""The one table of calibration's limits: what is refused, what is doubted, and how much must speak for a freedom.

Each stands with the rig that needs it: a row of docs/experiments/calibration.md, in quotes, or a real rig of that page.
Numbers that only end a loop, thin out work or draw a picture stand where they are used.
"""

# --- refused beyond
LEAST_MATCHES = 15  # of a pair of images after the two-view check: "two groups of 3 back to back"
LEAST_SHARED = 15  # points seen with two other images at once: "arc of 5, 40 degrees apart", "tele", uu_voxel
# Of a focal length, its standard deviation: "row of 6, parallel", "6 before a flat wall, parallel".
MOST_UNSURE = 0.05
ONE_PLACE = 0.001  # of the points' distance, between two cameras: two films of one camera (room with one film twice)
MOST_APART = 0.03  # of the rig or path, between two halves of the points: "studio", a box that sways (3.1 %)
LEAST_PLACED = 0.8  # of a moving camera's images: "studio", a box that goes along, 28 % (9 of 24); caliscope_charuco

# --- a warning from
FEW_SHARED = 60  # points: "3 cameras, little texture" (focal length 1 % off), "dark", "ring of 8"
DOUBTFUL_UNSURE = 0.02  # focal length: "3 cameras, little texture"
DOUBTFUL_APART = 0.005  # what is asked of centres: the wrong paths of "attic", a box that sways, lay 1 to 3 % apart
LEAST_AGREEING = 0.5  # of a camera's observations: "arc of 5 in a workshop, not in step" (16 % wrong)
MOST_MOVING = 0.08  # of near matches: "studio", a box that goes along, 50 %, has 13 %, hand_mono 4 %
PARALLEL = 5.0  # degrees between all directions, which the sentence names: "row of 6, parallel"

# --- believed
OWN_GAINS = 0.02  # of the cost, that focal lengths of their own must save: "6 focal lengths of 0.7 to 1.3"
DISTORTION_GAINS = 0.002  # of the held-out cost, before a coefficient is believed: "k1 = -0.1, little texture"
DISTORTION_SURE = 0.02  # standard deviation of the focal length with it, over the focal length: "3 cameras"
CHANCE = 3.0  # standard errors that a gain must exceed: "arc of 6, 15 degrees apart, little texture"

# --- boards
BOARD_IMAGES = 5  # that show the board, of each camera: caliscope_4cam (0 of 48)
BOARD_SHARED = 3  # frames in which two cameras saw it at once: sleap_board
BOARD_SCATTER = 15.0  # degrees by which half the frames may disagree on two cameras: charuco_4cam, not in step
BOARD_RESIDUAL = 0.004  # of the longer side, median of a camera's corners: films out of step, another board
DOUBTFUL_BOARD_RESIDUAL = 0.0015  # charuco_4cam has 0.0009
BOARD_FALSE = 0.008  # of the longer side: a corner that is farther off is another one
BOARD_GAINS = 0.02  # of the held-out cost, before k2 is believed: sleap_board (residual 0.25 instead of 0.51 pixels)
BOARD_SLOPE = 0.2  # of the image's height over the ray's, at the corner, with k2: cam_2 of charuco_4cam (-1.1)
