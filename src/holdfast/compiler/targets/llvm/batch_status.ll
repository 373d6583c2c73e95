  %total = load $T, ptr %sums, align $align
  %unsound = fcmp une $T %total, $zero
  %found = load $T, ptr $status, align $align
  %status = select <$lanes x i1> %unsound, $T $not_finite, $T %found
  store $T %status, ptr $status, align $align
  %bad = fcmp oge $T %status, $first_bad
  %some = call i1 @llvm.vector.reduce.or.v${lanes}i1(<$lanes x i1> %bad)
  br i1 %some, label %take.back, label %store

take.back:
$blank
  br label %store

store:
