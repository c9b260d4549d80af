"""The text of docs/evidence/blocks.md."""

from __future__ import annotations

PAGE = """# Blocks of several images

How accurate is an image without control that its neighbours hold, and does the block know it? All
data are simulated: scanners of 2.5 m, hills of 300 m unlike in every block, ties of 0.3 to 0.5 px
(some 140 an image in pairs and triplets, 60 in strips), vendors' RPCs that are off by a shift of 5,
20 or 50 px and a drift of 2 px (standard deviations). Vendors take the ground to be 40 m higher or
lower than it is. DEMs are off by 3 m as a whole and by 3 m that neighbours share. Figures are the
RMSE of independent check points, medians over images.

`python -m benchmarks.blocks --write` makes this page, from {seeds} blocks of a kind or the part of
them that the table says.

## Accuracy

"Without over six own" divides the RMSE of an image without control by what six points of its own
give it alone, with the strategy auto. "With over alone" does so where an image has six points in
the block. Medians, and the largest in brackets. The independent check points are the same.

"Bound" is the least that this ratio can be on average, whatever the method: the posterior standard
deviations of the block over those of six points, with all variances known. "RMSE to bound" divides
the RMSE of all images by that of the block's bound: 1 is as good as can be. Blocks without RPCs
have no such bound, as their errors have no known distribution. What is reached can be below the
bound of the ratio, as auto does not reach its own with six points. "In 90 %" is the share of images
whose RMSE the interval of 90 % holds.

{table}

Chi-square of ties compares errors of their places with the full covariance. That of control
compares the known noise with the estimate. Both should be 1. A block has few directions in which
it can be off as a whole, so that the figure of one kind varies by itself. Times are of CPU.

## What the bound says

- A pair with control in one image cannot hold the other: rays of two images meet at any height. The
  other image is off by the vendor's bias along the rays, unless the height of the ground is known:
  on a plain from control, in hills from a DEM.
- In a triplet with control in two images, the third is as good as its view is near theirs. If its
  view lies outside the two, their errors grow on the way to it: then the bound is 1.3 times what
  six own points give, and 1.0 with twenty points in either image. If its view lies between, the
  bound is 0.94 with six points.
- An image with six points gains from its neighbours across their rays only, so that its bound is
  0.95 in a triplet and 1 in a pair.
- The ratio of one image varies by chance, as auto sometimes meets the truth by luck. Reaching the
  bound does not keep single ratios below 1.02.

## The plain way

Without a block, ties can be intersected by hand: two images are fitted by auto to six points each,
34 ties in all three are intersected, and auto fits the third image to their places. The joint
adjustment uses all ties, and weighs their errors as they are. Medians; the last column counts the
blocks in which the third image is better by the joint adjustment.

{plain}

## A shift and a drift that are known

A pair with exact RPCs and noise of 0.02 px, into whose second image a shift of 12.3 and -7.1 px and
a drift of 3 and -2 px were put: the adjustment misses them by {missed:.3f} px at most. GDAL, by the
refined RPC as written, differs from the result by {gdal:.4f} px at most.

## Time and memory

Control in one image of thirty.

{scale}

{scipy}

{verdict}
"""

VERDICT = """## Other libraries, and several machines

GTSAM, g2o and Ceres solve the same normal equations by the same elimination of points. None has an
RPC or a vendor's prior. In Python each asks for the residuals of one measurement at a time, where
here an image is one call of numpy. They estimate no variances, drop no corrections and name no
blunders, which is what most steps here are for. So numpy and scipy.sparse it is.

Dask was considered for blocks of 1,000 images. A step takes some 3 s there. It would have to send
all places to all workers, and their rows back: 100 MB a step with 500 ties an image. The rows are
computed in less time than that takes to be packed. Parts of a larger block that no tie joins are
blocks of their own, and can be run side by side.

## What is missed

Targets are at most 0.95 for images without control, and for images with six points a median of
0.97 and none above 1.02. Chi-square should be 0.8 to 1.2, and intervals should hold 86 to 94 %.

- Images without control are above 0.95 where the bound is, whatever the method: it is 7.42 for a
  pair without a DEM (reached 5.75), 6.15 for a triplet with control in one image (4.73), 1.30 for a
  triplet with control in two (1.10), and 1.16 for 100 images with control in ten (0.96). With a DEM
  all kinds are below 0.95. Where the bound is below, blocks come near it and chance decides.
- Images with six points have a median below 0.97, though the bound is 1.00 in pairs (reached 0.97)
  and 0.95 in triplets (0.92): auto does not reach its own bound. The largest ratio is above 1.02,
  as single ratios scatter about the bound.
- Where images have no RPCs, intervals of ten or twenty blocks hold 73 to 83 %. The three images of
  a block err together, so that ten blocks give the share to some 8 %. In 160 other blocks, by which
  nothing was chosen, 86 % hold (standard error 2 %). They are 40 of each kind but that of scanners.
  By kind, in the order of the table, 88, 84, 84 and 88 % hold. Beyond the upper end are 5 %, below
  the lower one 8 %, and the predicted RMSE is 1.10 times the actual one (median).
- Before, good control was left out: ten points in 30 blocks with twenty points in two images.
  Weights that fall had made its standard deviation 0.74 times as large, and a point left out was
  compared with its error alone. Of those 30 blocks 80 % were held and 13 % beyond the upper end,
  and are 86 and 4 %; errors are 4 % smaller (RMSE). In the 160 blocks no point was left out, by a
  limit that was wider where points are few. It is now four standard deviations, or what any point
  reaches in 5 % of blocks with good control. In 160 further blocks with 4 to 40 points one of 1,599
  good ones is beyond it. A blunder of 5 px, which is 12 standard deviations, is named in 9 of 12
  blocks with three points in each of two images. With four in one image it is named in 8 of 12. The
  wider limit named none of six of either kind. What remains: where no image has an RPC, the squared
  standard deviation of control is 1.08 to 1.20 of the true one. Terms that were dropped do not
  explain it. In bent blocks 9 % are beyond the upper end.
- How far images bend is unknown, and nine combinations of their terms of degree 2 describe it, as a
  bent ground explains the others. Those terms are 0.0003 of half an image here (root mean square).
  In ten vendors' RPCs of real images they are 0.0001 to 0.0019, with 0.0007 in the middle, and
  0.0002 is the least that a block takes.
- One point in each image is enough for less than a pixel where vendors' RPCs drift by 0.3 px, not
  with 2 px: a point cannot separate drift from shift. Nor does it show how large drifts are. The
  mean over all that are possible makes chi-square 1.10 in pairs with a drift of 2 px, and 0.37 with
  one of 0.3 px. Intervals hold 90 and 88 %, and 47 % where one variance was taken for known (16
  other blocks).
- A sensor that is nearly right is not always noticed by its terms. With `planetscope`, whose pixel
  of 4 m and view straight down are wrong, all of eight blocks of three images said so. A sensor
  with the right pixel and orbit that looks straight down to 0.5 degrees, for views of 20 degrees,
  agrees with what is known of it, as the ground bends or control is pushed away instead. So each
  sensor that images state is compared with an unknown one. The unknown one is taken where the
  ground is 1.1 times as rough with the sensor, or control 10,000 times less probable. The
  probability is that of each point, as all others predict it. The ground does not count where
  control is 10,000 times as probable with the sensor. Of 17 triplets with that wrong sensor in all
  images all are named, where four were not. Before, an image was 7.0 px off under an interval that
  ended at 1.8, as terms named the sensor in two of three images. A sensor is one claim, and is now
  held in none that state it: the image is 0.8 px off. The worst images of the 17 are 0.8 to 3.6 px
  off, but for two blocks with noise of 0.5 px. There they are 4.9 and 6.9 px off, and their
  intervals end at 5.8 and 16.8. Five of the 51 images are beyond theirs, the farthest with 2.0 px
  for 1.2. In 31 triplets with the right sensor no note was made where rough ground or control left
  out led to the comparison. Of 16 triplets that are always compared, as all are now, none has a
  note. The factor was kept for three of them: control is 27 times as probable without the sensor at
  most. With three points in each of two images, an image follows each of its points to some 99 %.
  The others then say little or nothing of that point, and the ground decides. Of 11 such triplets
  two lose the right sensor. Their worst images are 14 and 7 px off, and with the sensor 84 and 43
  px. A sensor that is stated costs a second adjustment, so that three images take 7 to 13 s of CPU.
  Where one of three images states the wrong sensor and two the right one, the wrong one alone is
  named. The same holds for a block of two images.
- Without control the DEM is taken at its word. Where it is 100 or 200 m off and vendors' RPCs are
  20 px off, images are 14 and 28 px off and intervals end at 11. The RPCs give heights to 100 m, so
  that nothing contradicts. A note states how many px images are off for each 100 m.
- Images of one block err together, so that shares of few blocks are rough. In 40 other blocks of
  the two kinds "triplet" and "triplet, third between" intervals hold 88 and 84 %.
- Writing the results of all images takes about as long as the adjustment, as each is compared with
  other models by itself: 0.26 to 0.28 s of CPU an image with an RPC. Blocks of 100, 300 and 1,000
  images take 28, 84 and 261 s of CPU to write, and 17, 65 and 303 s to adjust, with 51,000, 190,000
  and 681,000 measurements of ties. The whole of 1,000 images takes 9.4 minutes of CPU and 1.8 GiB,
  and 12.6 times as long as 100 images, with 13.5 times as many measurements. Their table is read in
  another 6 s. Two processes that write would end at most 1.3 times as soon, so that there is one.
- The machine was busy, so that seconds on this page are up to twice as many as on a quiet one.
"""
