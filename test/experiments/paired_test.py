"""Statistics of pairs, against published values."""

import math
import unittest

import numpy as np
from scipy import stats

from experiments.paired import mean_interval, median_interval, paired, sign_test


class SignTest(unittest.TestCase):
    def test_the_published_example_of_hours_of_sleep(self) -> None:
        """Student 1908 (Cushny and Peebles' ten patients): hours gained by two drugs; nine of ten gain more, one ties."""
        first = [0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0]
        second = [1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4]
        result = paired(first, second)
        self.assertEqual((result.pairs, result.smaller, result.larger), (10, 9, 0))
        self.assertAlmostEqual(result.sign_test_p, 2 / 2**9)
        # Student's t of these differences: mean 1.58, 95 % interval 0.70 to 2.46 (as in R's documentation of `sleep`).
        self.assertAlmostEqual(result.mean, -1.58)
        self.assertAlmostEqual(result.mean_interval[0], -2.4598858, 6)
        self.assertAlmostEqual(result.mean_interval[1], -0.7001142, 6)

    def test_critical_values_of_dixon_and_mood(self) -> None:
        """Their table: at 5 %, r of the rarer sign may be 1 of 9, 5 of 20, 9 of 30 at most, and no more."""
        for pairs, critical in ((6, 0), (9, 1), (20, 5), (30, 9), (50, 17)):
            self.assertLessEqual(sign_test(critical, pairs - critical), 0.05)
            self.assertGreater(sign_test(critical + 1, pairs - critical - 1), 0.05)

    def test_three_pairs_show_nothing(self) -> None:
        self.assertEqual(sign_test(3, 0), 0.25)
        self.assertEqual(sign_test(0, 0), 1.0)

    def test_pairs_without_a_figure_are_left_out(self) -> None:
        result = paired([1.0, math.nan, 3.0], [2.0, 2.0, 3.0])
        self.assertEqual((result.pairs, result.smaller, result.larger), (2, 1, 0))
        with self.assertRaises(ValueError):
            paired([1.0], [1.0, 2.0])


class Intervals(unittest.TestCase):
    def test_the_medians_interval_has_the_ranks_of_the_tables(self) -> None:
        """Conover 1999: 95 % for the median of 20 is from the 6th to the 15th, of 10 from the 2nd to the 9th."""
        for count, rank in ((10, 2), (20, 6), (25, 8)):
            values = np.arange(1.0, count + 1)
            self.assertEqual(median_interval(values, 0.95), (rank, count + 1 - rank))

    def test_five_pairs_give_no_interval_of_the_median(self) -> None:
        self.assertTrue(all(map(math.isnan, median_interval(np.arange(5.0), 0.95))))
        self.assertEqual(median_interval(np.arange(6.0), 0.95), (0.0, 5.0))

    def test_intervals_cover_the_truth_as_often_as_they_say(self) -> None:
        rng = np.random.default_rng(7)
        draws = rng.exponential(size=(2000, 20))
        median = math.log(2)
        covered = [low <= median <= high for low, high in (median_interval(d, 0.95) for d in draws)]
        exact = 1 - 2 * stats.binom.cdf(5, 20, 0.5)
        self.assertAlmostEqual(float(np.mean(covered)), exact, delta=0.015)
        normal = rng.normal(3, 2, size=(2000, 5))
        covered = [low <= 3 <= high for low, high in (mean_interval(d, 0.95) for d in normal)]
        self.assertAlmostEqual(float(np.mean(covered)), 0.95, delta=0.015)


if __name__ == "__main__":
    unittest.main()
