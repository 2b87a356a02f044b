#pragma once

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/smoother_reports.hpp"

namespace chainslam {

/// Set on three real drives of NCLT with sampled closures, right and wrong (test/slam/nclt_sessions_test.cpp).
struct IncrementalGncOptions {
  double growth = 2.0;   ///< of the control parameter, per step
  Index max_steps = 40;  ///< smoother updates per call
  /// Unexpected groups that agree with each other, so that it is tried what follows from them all: an outlier that was
  /// taken in, or a trusted factor that is wrong, makes all later ones unexpected.
  Index support = 2;
  /// Standard deviations of a measurement up to which the way between two may be uncertain, if they are to agree:
  /// farther apart, any two would.
  double max_blur = 10.0;
  Index memory = 50;               ///< unexpected groups that are remembered for that
  double consecutive_price = 0.1;  ///< fraction of its price that an outlier costs shortly after another
  Index consecutive_gap = 3;       ///< of the same sequence: so many places after it at most
  /// Rows of residuals of suspects near a change, the newest first, that an update tries the other way round.
  Index tried_rows = 600;
};

/// How a factor that may be wrong is judged.
struct Suspicion {
  /// Squared whitened residual beyond which it is an outlier. 0: what one good factor in a hundred exceeds.
  double threshold = 0.0;
  /// What an outlier costs the truncated squares. 0: its threshold.
  double price = 0.0;
  /// What an outlier still counts. More than 0 for what alone may hold parts of the graph together.
  double outlier_weight = 0.0;
  bool begins_in = true;  ///< or as an outlier, as it was when it was saved
  /// Whether it begins as an outlier where the graph, by its own covariance, does not expect it: its error would be
  /// shared out over what is less certain, and never show.
  bool forecast = false;
  /// Whether it is beyond suspicion until enough others agree that the graph is wrong.
  bool trusted = false;
  /// Number of the preceding suspect of a sequence that fails as a whole, such as steps of odometry: of consecutive
  /// outliers only the first costs its full price. -1: none.
  Index previous = -1;
};

/// What an update did.
struct IncrementalGncReport {
  UpdateReport last;    ///< of the last update
  Index steps = 0;      ///< updates
  bool decided = true;  ///< whether each suspect is in or out, as its residual says; else the steps did not suffice
};

}  // namespace chainslam
