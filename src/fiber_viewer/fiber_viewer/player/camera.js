// SPDX-License-Identifier: Apache-2.0
// The part of the focal plane that a canvas shows: y points up, both axes have the same scale.

export class Camera {
  constructor() {
    this.x = this.y = 0; // point in the middle [mm]
    this.scale = 1; // [CSS pixels per mm]
    this.width = this.height = 1; // of the canvas [CSS pixels]
  }

  /** Shows a box [mm] as large as possible. `margin` is the ratio of the view to the box. */
  fit(left, bottom, right, top, margin = 1.04) {
    this.x = (left + right) / 2;
    this.y = (bottom + top) / 2;
    const across = Math.max(right - left, 1e-6), up = Math.max(top - bottom, 1e-6);
    this.scale = Math.min(this.width / across, this.height / up) / margin;
  }

  /** Returns the pixel of a point in the plane [mm]. */
  toPixel(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  /** Returns the point in the plane [mm] under a pixel. */
  toPlane(px, py) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  /** Zooms by a factor about the point under a pixel. */
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toPlane(px, py);
    this.scale = Math.min(400, Math.max(0.05, this.scale * factor));
    const [nx, ny] = this.toPlane(px, py);
    this.x += x - nx;
    this.y += y - ny;
  }

  /** Returns whether some of a disc about a point [mm] is visible. */
  sees(x, y, radius) {
    const [px, py] = this.toPixel(x, y), r = radius * this.scale;
    return px > -r && py > -r && px < this.width + r && py < this.height + r;
  }
}
