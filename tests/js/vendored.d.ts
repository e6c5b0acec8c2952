// Libraries of web/vendor whose types nobody has written.
declare module "@sparkjsdev/spark";
declare module "laz-perf";
declare module "fflate";
