// Weights of linear red, green and blue in the brightness of a colour (BT.709), as in dynamictree/color.py.

export const LUMINANCE = "vec3(0.2126, 0.7152, 0.0722)";
