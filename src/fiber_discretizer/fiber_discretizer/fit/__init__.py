"""Line fitting: a sampled profile as the fewest straight pieces inside its corridor."""
