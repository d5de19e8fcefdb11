// Which part of the focal plane a canvas shows: y points up, one scale for both axes.

export class Camera {
  constructor() {
    this.x = this.y = 0; // point in the middle [mm]
    this.scale = 1; // [CSS pixels a mm]
    this.width = this.height = 1; // of the canvas [CSS pixels]
  }

  /** Shows a box [mm] as large as it fits. */
  fit(left, bottom, right, top, margin = 1.04) {
    this.x = (left + right) / 2;
    this.y = (bottom + top) / 2;
    const across = Math.max(right - left, 1e-6), up = Math.max(top - bottom, 1e-6);
    this.scale = Math.min(this.width / across, this.height / up) / margin;
  }

  /** Pixel of a point in the plane. */
  toPixel(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  /** Point in the plane [mm] under a pixel. */
  toPlane(px, py) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  /** Zooms by a factor; the point under a pixel stays where it is. */
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toPlane(px, py);
    this.scale = Math.min(400, Math.max(0.05, this.scale * factor));
    const [nx, ny] = this.toPlane(px, py);
    this.x += x - nx;
    this.y += y - ny;
  }

  /** Whether a disc about a point [mm] can be seen. */
  sees(x, y, radius) {
    const [px, py] = this.toPixel(x, y), r = radius * this.scale;
    return px > -r && py > -r && px < this.width + r && py < this.height + r;
  }
}
